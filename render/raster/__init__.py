"""How much of what each pixel sees, in closed form."""
