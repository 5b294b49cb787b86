"""Style of the interactive pages beyond viser's theme: text of 14 px or more, and controls for fingers.

viser's page scales with the font size of its root, which it sets to 13 to 15 px. Below `PHONE_PX` its panel
has the width of a desktop's. Its classes begin with `mantine`, those of the curves with `u-`.
"""

from typing import TYPE_CHECKING

from skyherd.play.poses import PANEL_SHARE, PHONE_PX
from skyherd.report.pages import render_page

if TYPE_CHECKING:
    import viser


def add_style(server: "viser.ViserServer") -> None:
    """Add the style to all pages of a server."""
    values = {"phone_px": PHONE_PX, "panel_percent": round(100 * PANEL_SHARE)}
    server.gui.add_html(render_page("skyherd.play", "page_style.html", **values))
