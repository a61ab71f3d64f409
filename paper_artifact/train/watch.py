"""What a run on photographs says while it runs: one sentence for each thing that goes wrong, once.

Only what was measured is said, with an option to try. Nothing here changes the run.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from paper_artifact.config import RunConfig
from paper_artifact.evaluate.image import view_scores
from paper_artifact.scene.cameras import picture_radii
from paper_artifact.scene.load import Scene
from paper_artifact.soup.state import Soup

WINDOW = 100  # steps over which losses are averaged
QUIET = 1 / 3  # of the run's steps: before that, nothing has settled
RISEN, FALLEN = 1.05, 0.9  # of the lowest window so far, of the first one: a loss above either is said
POOR = 16.0  # dB on training views; good photographs read 20 and more
LOOKED_AT = 8  # training views that are rendered for that, once
LEFT = 0.1  # share of the triangles by which those outside all views grow


@dataclass
class Watch:
    """Looks at a run before each of its resamplings."""

    scene: Scene
    config: RunConfig
    tell: Callable[[str], None]  # is called with each sentence
    said: dict[str, str] = field(default_factory=dict)  # what each check said
    outside: float | None = None  # share of the triangles that no view shows, at the first look

    def look(self, step: int, losses: list[float], soup: Soup) -> None:
        """Check the run after `step` (1-based); losses: of all steps so far; soup: on the CPU."""
        slower = f"try --set vertex_lr={self.config.vertex_lr / 2:g}"
        share = self._outside(soup)
        if self.outside is None:
            self.outside = share
        elif share > self.outside + LEFT:
            self._say(
                "outside",
                f"step {step}: {share:.0%} of the triangles lie outside all views, {self.outside:.0%} did at "
                f"first; {slower}",
            )
        if step < QUIET * self.config.steps:
            return
        means = [float(np.mean(losses[end - WINDOW : end])) for end in range(WINDOW, step + 1, WINDOW)]
        if len(means) > 1:
            best = int(np.argmin(means[:-1]))
            if means[-1] > min(RISEN * means[best], FALLEN * means[0]):
                self._say(
                    "loss",
                    f"step {step}: the loss does not fall, over the last {WINDOW} steps it is "
                    f"{means[-1]:.3g}, up to step {WINDOW * (best + 1)} it was {means[best]:.3g}; {slower}",
                )
        if "looked" not in self.said:
            train = self.scene.train
            views = train[np.unique(np.linspace(0, len(train) - 1, LOOKED_AT).round().astype(int))]
            value = self.said["looked"] = f"{view_scores(soup, self.scene, views)['psnr']:.1f}"
            if float(value) < POOR:
                self._say(
                    "psnr",
                    f"step {step}: the views that are trained on read {value} dB, less than {POOR:g}, as "
                    f"pictures do that hardly look like their photographs; {slower}, or "
                    f"--set budget={2 * self.config.budget}, and see that `photos` registered them well",
                )

    def sentences(self) -> list[str]:
        """Return what was said."""
        return [text for name, text in self.said.items() if name != "looked"]

    def _say(self, name: str, text: str) -> None:
        if name not in self.said:
            self.said[name] = text
            self.tell(text)

    def _outside(self, soup: Soup) -> float:
        corners = soup.vertices.detach().numpy()
        shown = picture_radii(corners, self.scene.world_to_clip[self.scene.train])[1]
        return float(1 - shown.any(axis=1).mean())
