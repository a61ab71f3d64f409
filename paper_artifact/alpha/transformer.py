"""Alpha persistence as a scikit-learn transformer; needs scikit-learn."""

from __future__ import annotations

from typing import Any

import numpy as np
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from paper_artifact.alpha.persistence import Pairs, alpha_persistence, check_points, is_batch
from paper_artifact.errors import InputError, whole


class AlphaTransformer(TransformerMixin, BaseEstimator):
    """Turns each point cloud into the lifetimes of its longest bars, a row of fixed length.

    X: a batch (b,n,3) or (b,n,2), or a list of such clouds of different sizes; or a table (b,f), whose rows
    are signals: a signal's cloud is its delay embedding in space, (x_t, x_{t+delay}, x_{t+2 delay}), cyclic.
    Output: (b, 3 longest) float64 for clouds in space, (b, 2 longest) in the plane: for each dimension the
    `longest` largest lifetimes in decreasing order, 0 where there are fewer.
    """

    def __init__(self, longest: int = 10, delay: int = 1) -> None:
        """longest: bars for each dimension; delay: of the embedding of signals, in samples."""
        self.longest = longest
        self.delay = delay

    def fit(self, X: Any, y: Any = None) -> AlphaTransformer:
        """Check X; nothing is learnt."""
        self._clouds(X, reset=True)
        self.fitted_ = True
        return self

    def transform(self, X: Any) -> np.ndarray:
        """Return the longest lifetimes of every cloud of X. Raises InputError for what is no cloud."""
        check_is_fitted(self)
        return np.stack([self._row(bars) for bars in alpha_persistence(self._clouds(X, reset=False))])

    def _clouds(self, X: Any, reset: bool) -> Any:
        for name in ("longest", "delay"):
            whole(name, getattr(self, name), 1, 10**6)
        if is_batch(X):
            clouds = [check_points(each) for each in X]
            if len({each.shape[1] for each in clouds}) != 1:
                raise InputError("X has no clouds, or some in space and some in the plane; give one kind")
            if reset:
                self.dimension_ = clouds[0].shape[1]
            elif getattr(self, "dimension_", 3) != clouds[0].shape[1]:
                raise InputError(
                    f"X has clouds in {clouds[0].shape[1]} dimensions, and not as in fit; fit again"
                )
            return clouds
        X = X.detach() if hasattr(X, "detach") else X
        table = validate_data(self, X, reset=reset, dtype=np.float64)
        return np.stack([np.roll(table, -k * self.delay, axis=1) for k in range(3)], axis=-1)

    def _row(self, bars: tuple[Pairs, ...]) -> np.ndarray:
        row = []
        for pairs in bars:
            lives = np.sort(pairs.deaths - pairs.births)[::-1][: self.longest]
            row.append(np.pad(lives, (0, self.longest - len(lives))))
        return np.concatenate(row)
