"""Style of the interactive pages beyond viser's theme: text of 14 px or more, and controls for fingers.

viser's page scales with the font size of its root, which it sets to 13 to 15 px. Below `PHONE_PX` its panel
has the width of a desktop's. Its classes begin with `mantine`, those of the curves with `u-`.
"""

from typing import TYPE_CHECKING

from skyherd.play.poses import PANEL_SHARE, PHONE_PX

if TYPE_CHECKING:
    import viser

STYLE = f"""<style>
html {{ font-size: 16px !important; --mantine-font-size-xs: 14px !important; }}
.u-legend, .mantine-Slider-markLabel, .mantine-Tabs-tab, [role="tab"] {{ font-size: 14px !important; }}
.mantine-Slider-root {{ margin-bottom: 10px; }}
.mantine-Notification-root * {{ font-size: 14px; }}
@media (max-width: {PHONE_PX}px) {{
  .mantine-Paper-root[style*="position: fixed"] {{
    width: 100% !important; max-height: {PANEL_SHARE:.0%} !important; }}
  .mantine-Paper-root[style*="position: fixed"] [style*="width: 20em"] {{ width: 100% !important; }}
}}
@media (max-width: {PHONE_PX}px), (pointer: coarse) {{
  .mantine-Button-root, .mantine-Input-input, .mantine-Tabs-tab, [role="tab"] {{
    min-height: 44px !important; font-size: 16px !important; }}
  .mantine-ActionIcon-root, .mantine-CloseButton-root {{
    min-width: 44px !important; min-height: 44px !important; }}
  .mantine-NumberInput-controls {{ display: none !important; }}
  .mantine-Slider-thumb {{ width: 24px !important; height: 24px !important; }}
  .mantine-Slider-thumb::after {{ content: ""; position: absolute; inset: -10px; }}
  .mantine-Slider-markLabel {{ margin-top: 9px; }}
}}
</style>"""


def add_style(server: "viser.ViserServer") -> None:
    """Add the style to all pages of a server."""
    server.gui.add_html(STYLE)
