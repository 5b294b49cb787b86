"""Collision avoidance of robots with bodies: reports of nearby bodies, bounds on approach speeds, detours."""
