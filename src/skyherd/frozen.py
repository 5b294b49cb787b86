"""Arrays of a frozen dataclass: checked when it is made, copied in, read-only."""

import numpy as np

from skyherd.errors import MessageError


def freeze(owner: object, name: str, shape: tuple[int | None, ...], *, integer: bool = False) -> None:
    """Replace a field by a checked, read-only copy of itself."""
    array = np.array(getattr(owner, name), dtype=np.int64 if integer else np.float64)
    if array.size == 0 and 0 in [want for want in shape if want is not None]:
        array = array.reshape([want or 0 for want in shape])
    if array.ndim != len(shape) or any(
        want is not None and want != have for want, have in zip(shape, array.shape, strict=True)
    ):
        raise MessageError(f"{type(owner).__name__}.{name}: shape {array.shape}, expected {shape}")
    if not integer and not np.isfinite(array).all():
        raise MessageError(f"{type(owner).__name__}.{name}: every value must be finite")
    array.setflags(write=False)
    object.__setattr__(owner, name, array)


def freeze_ids(owner: object, name: str) -> int:
    """Freeze a field of robot ids and refuse a repeated one; returns their number."""
    freeze(owner, name, (None,), integer=True)
    ids = getattr(owner, name)
    if np.unique(ids).size != ids.size:
        raise MessageError(f"{type(owner).__name__}.{name}: repeated id in {ids.tolist()}")
    return int(ids.size)
