"""Robot-side control: fusion of received goals, and the law that turns them into speeds."""
