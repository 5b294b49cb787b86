"""Export of a run, simulated or live, to formats of other programs: CSV, Parquet, rosbag2 and COCO."""

from skyherd.recording.export.job import FORMATS, Exported, export_run
from skyherd.recording.export.recorded_run import Commanded, Moment, RecordedRun, Seen, Truth
from skyherd.recording.export.simulated import read_simulated

__all__ = [
    "FORMATS",
    "Commanded",
    "Exported",
    "Moment",
    "RecordedRun",
    "Seen",
    "Truth",
    "export_run",
    "read_simulated",
]
