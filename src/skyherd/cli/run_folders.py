"""Folders of recorded runs, as verbs take them."""

import os
from pathlib import Path

from skyherd.errors import InputError


def is_simulated_run(folder: Path, verb: str) -> bool:
    """Return whether a folder is that of a simulated run; False for one of a live run.

    Args:
        folder: the folder.
        verb: the verb that takes it, for error messages.

    Raises:
        InputError: it is not the folder of a run.
    """
    from skyherd.datasets import refuse_configuration
    from skyherd.live.review import recorded_files
    from skyherd.runner import RECORDING

    allowed = "the output folder of `skyherd run` or `skyherd live run`"
    if not os.path.isdir(folder):
        if folder.name == RECORDING and os.path.isdir(folder.parent):
            raise InputError(
                str(folder), "is a recording", f"give its folder: `skyherd {verb} {folder.parent}`"
            )
        refuse_configuration(folder, "run")
        what = "is a file" if os.path.lexists(folder) else "no such folder"
        raise InputError(str(folder), what, allowed)
    is_simulated = os.path.lexists(folder / RECORDING)
    if not is_simulated and not recorded_files(folder):
        what = f"no {RECORDING} in it, and no recordings of units or robots"
        raise InputError(str(folder), what, allowed)
    return is_simulated
