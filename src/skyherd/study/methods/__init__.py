"""Study of formation controllers: several control laws compared from the same starts."""
