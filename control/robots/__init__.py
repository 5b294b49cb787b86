"""The robots' side of control: a robot combines the goals that it received and turns them into speeds."""
