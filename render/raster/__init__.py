"""Which pixels a flat shape touches, and how much of it each of them gathers, in closed form."""
