"""Which views of a scene are held out of training, to be judged on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from paper_artifact.errors import InputError

EVERY = 8  # of that many views one is held out, as in Mip-NeRF 360 and DiffSoup
AUTO, NONE = "auto", "none"


def held_out(rule: str, names: Sequence[str], centres: np.ndarray) -> np.ndarray:
    """Return the indices (m,) int64 of the views that are held out, increasing.

    names: of the views, sorted; centres (n,3): their cameras', world units. rule: "none"; a number k (every
    k-th from the first on); names with commas between; or "auto" (`surrounded`). Raises InputError for
    another rule, an unknown name, or a rule that leaves no view to train on.
    """
    if rule == NONE:
        return np.arange(0)
    if rule == AUTO:
        return surrounded(centres)
    if rule.isdecimal():
        chosen = np.arange(0, len(names), max(1, int(rule)))
    else:
        asked = [name.strip() for name in rule.split(",") if name.strip()]
        unknown = [name for name in asked if name not in names]
        if unknown or not asked:
            raise InputError(
                f"no view is called {', '.join(unknown) or repr(rule)}; hold out every k-th (a number), "
                f"{NONE}, {AUTO}, or names such as {names[0]},{names[-1]}"
            )
        chosen = np.array(sorted({list(names).index(name) for name in asked}))
    if len(chosen) == len(names):
        raise InputError(f"holding out {rule!r} leaves no view to train on; hold out fewer of {len(names)}")
    return chosen


def surrounded(centres: np.ndarray) -> np.ndarray:
    """Return of about eight consecutive views each the one whose second nearest camera is nearest, (m,).

    Photographs are taken along a walk, whose first view, which "every 8th" would hold out, is often the
    extreme one: nothing else has seen what it sees, and its score says nothing of the soup. The rule looks at
    cameras alone, never at pictures. Ties go to the middle of the eight; two cameras (n,3) hold out one.
    """
    count = len(centres)
    if count < 3:
        return np.arange(count - 1, count)
    distance = cKDTree(centres).query(centres, k=3)[0][:, 2]
    rank = np.round(distance / distance.max(), 3) if distance.max() > 0 else distance
    found = []
    for block in np.array_split(np.arange(count), max(1, round(count / EVERY))):
        middle = np.abs(block - block.mean())
        found.append(int(block[np.lexsort((block, middle, rank[block]))[0]]))
    return np.array(found)
