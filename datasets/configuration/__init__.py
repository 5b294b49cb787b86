"""Scenario files: their keys, checked one by one, and the missions made from them.

`models` contains the Pydantic model of a scenario. Its parts are in `scene_models`, `unit_models` and
`body_models`. Every key has a range and a description with its unit, which `skyherd scenario schema` prints.
`mission` reads a scenario and completes it with template, start and obstacles.

A model makes the object that it describes in its method `make()` (`CameraModel.make`, `SensorModel.make`,
`GroundModel.make`, `OccluderModel.make`). A model that describes several objects has methods `make_…()`
(`SensorModel.make_shutter`, `Scenario.make_bodies`). Random generators and pictures are arguments of these
methods.
"""
