"""A study of formation controllers: several control laws compared on the same starts."""
