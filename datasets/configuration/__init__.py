"""Scenario files: their keys, checked one by one, and the missions made of them.

`models` holds a whole scenario as Pydantic models, its parts in `scene_models`, `unit_models` and
`body_models`. Every key has a range and a description with its unit, which `skyherd scenario schema` prints.
`mission` reads a scenario and completes it: template, start, obstacles.

There is one way from a model to the thing that it describes: its method `make()` (`CameraModel.make`,
`SensorModel.make`, `GroundModel.make`, `OccluderModel.make`), or `make_…()` where one model describes more
than one thing (`SensorModel.make_shutter`, `Scenario.make_bodies`). What a model cannot know, such as a
random generator or a picture that was read, is an argument of it.
"""
