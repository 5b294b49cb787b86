"""Report of a live run: the joined recordings of its processes, and a page about them.

Start with `make_live_report`; `read_live_run` is for exports.
"""

from skyherd.live.review.page import make_live_report
from skyherd.live.review.recorded_run import read_live_run
from skyherd.live.review.session_history import recorded_files

__all__ = ["make_live_report", "read_live_run", "recorded_files"]
