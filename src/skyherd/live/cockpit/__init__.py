"""Page of a live run while it runs: images of the units, states of the processes, and a stop button.

Start with `Cockpit`. Nothing on the page can arm a robot.
"""

from skyherd.live.cockpit.cockpit import Cockpit, ProcessState
from skyherd.live.cockpit.previews import PREVIEWS, PreviewWriter
from skyherd.live.cockpit.server import PageAddress

__all__ = ["PREVIEWS", "Cockpit", "PageAddress", "PreviewWriter", "ProcessState"]
