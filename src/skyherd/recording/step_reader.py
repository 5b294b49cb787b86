"""Reconstruction of one step of a run from its recorded messages."""

import base64
from typing import Any

import numpy as np

from skyherd.control import Conditions, Decision, GroundMap, rectified
from skyherd.datasets import Mission, read_interventions
from skyherd.files.images import decode_jpeg
from skyherd.loop import Step, UnitFrame
from skyherd.messages import Detections, FlightCommand, MotionGoals, Proximity, UnitReport, VelocityCommand
from skyherd.messages.role_map import RoleMap
from skyherd.messages.tree_status import TreeStatus
from skyherd.recording.json_codec import from_plain
from skyherd.recording.plausible import check_map, check_places
from skyherd.sim.sight import Sight
from skyherd.sim.truth_metrics import ShapeFit, TruthMetrics
from skyherd.sim.world import Fleet


def read_step(time_s: float, records: dict[str, Any], mission: Mission) -> Step:
    """Return the step at a time, from the contents of its messages by topic.

    Raises:
        KeyError, TypeError, ValueError: a message is missing, or does not have this version's form.
        InputError: a message has impossible values.
    """
    changes = records.get("/interventions", {"interventions": []})
    units = sorted(int(topic.split("/")[2]) for topic in records if topic.endswith("/detections"))
    observer, world = records["/metrics"], records["/world"]
    return Step(
        time_s=time_s,
        positions_m=np.array(world["positions_m"], dtype=float),
        headings_rad=np.array(world["headings_rad"], dtype=float),
        fleet=from_plain(Fleet, world["fleet"]),
        frames={
            unit: _read_frame(f"/unit/{unit}", records, mission.scenario.units[unit].camera.size_px)
            for unit in units
        },
        command=from_plain(VelocityCommand, records["/robots/command"]),
        commanded_ids=np.array(observer["commanded_ids"], dtype=np.int64),
        control_sets={
            int(unit): np.array(ids, dtype=np.int64) for unit, ids in observer["control_sets"].items()
        },
        metrics=from_plain(
            TruthMetrics,
            observer,
            conditions=Conditions(**observer["conditions"]),
            shape=ShapeFit(**observer["shape"]),
        ),
        roles=np.array(observer["roles"], dtype=np.int64),
        interventions=read_interventions(changes["interventions"]),
    )


UNSENT = "the camera was suspected"
"""Suspicion of a unit whose recording lacks its report: it sent nothing."""


def _read_frame(topic: str, records: dict[str, Any], size_px: tuple[int, int]) -> UnitFrame:
    truth, goals, turns, image, near = (
        records[f"{topic}/truth"],
        records.get(f"{topic}/goals"),
        records.get(f"{topic}/turns"),
        records.get(f"{topic}/image"),
        records.get(f"{topic}/proximity"),
    )
    sight = Sight(
        detections=from_plain(Detections, records[f"{topic}/detections"]),
        whole_ids=np.array(truth["whole_ids"], dtype=np.int64),
        found_ids=np.array(truth["found_ids"], dtype=np.int64),
        false_detections=truth["false_detections"],
        image=None if image is None else decode_jpeg(base64.b64decode(image["data"]), size_px),
    )
    recorded_map = records.get(f"{topic}/map")
    ground_map = GroundMap() if recorded_map is None else from_plain(GroundMap, recorded_map)
    check_map(ground_map)
    check_places(sight.detections)
    report = records.get(f"{topic}/report")
    decision = Decision(
        detections=rectified(sight.detections, ground_map),
        goals=None if goals is None else from_plain(MotionGoals, goals),
        report=UnitReport.of_image(sight.detections) if report is None else _read_report(report),
        flight=from_plain(FlightCommand, records[f"{topic}/flight"]),
        proximity=None if near is None else from_plain(Proximity, near),
        turns=None if turns is None else from_plain(MotionGoals, turns),
        ground_map=ground_map,
        suspicion=UNSENT if report is None else "",
    )
    return UnitFrame(sight, decision)


def _read_report(record: dict[str, Any]) -> UnitReport:
    tree, roles = record.get("tree"), record.get("roles")
    return from_plain(
        UnitReport,
        record,
        tree=None if tree is None else from_plain(TreeStatus, tree),
        roles=None if roles is None else from_plain(RoleMap, roles),
    )
