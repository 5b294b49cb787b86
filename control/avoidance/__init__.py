"""Collision avoidance: reports of nearby bodies, bounds on approach speeds, detours."""
