"""Arrays of a frozen dataclass: checked when it is made, copied in, read-only."""

import numpy as np

from skyherd.errors import MessageError


def freeze(owner: object, name: str, shape: tuple[int | None, ...], *, integer: bool = False) -> None:
    """Replace a field by a checked, read-only copy of itself."""
    array = np.array(getattr(owner, name), dtype=np.int64 if integer else np.float64)
    if array.shape != shape:
        array = _fitted(array, shape)
    if array.shape != shape and not _fits(array.shape, shape):
        raise MessageError(f"{type(owner).__name__}.{name}: shape {array.shape}, expected {shape}")
    if not integer and not np.isfinite(array).all():
        raise MessageError(f"{type(owner).__name__}.{name}: every value must be finite")
    array.setflags(write=False)
    object.__setattr__(owner, name, array)


def _fitted(array: np.ndarray, shape: tuple[int | None, ...]) -> np.ndarray:
    """An empty array in the shape that is wanted; others as they are."""
    if array.size == 0 and 0 in shape:
        return array.reshape([want or 0 for want in shape])
    return array


def _fits(have: tuple[int, ...], want: tuple[int | None, ...]) -> bool:
    return len(have) == len(want) and all(w is None or w == h for w, h in zip(want, have, strict=True))


def freeze_ids(owner: object, name: str) -> int:
    """Freeze a field of robot ids and refuse a repeated one; returns their number."""
    freeze(owner, name, (np.size(getattr(owner, name)),), integer=True)
    ids = getattr(owner, name)
    if len(set(ids.tolist())) != ids.size:
        raise MessageError(f"{type(owner).__name__}.{name}: repeated id in {ids.tolist()}")
    return int(ids.size)
