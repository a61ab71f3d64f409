"""How long a sweep will still take, from its runs that ended and from the steps of those in progress."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import mean

from paper_artifact.config import RunConfig
from paper_artifact.scene.given import called


@dataclass(frozen=True)
class Outcome:
    """One run's end."""

    config: RunConfig
    seconds: float  # of wall time
    failure: str | None  # why it failed, None when it is recorded


@dataclass(frozen=True)
class Step:
    """What a run in progress tells."""

    config: RunConfig
    step: int  # taken by now
    seconds: float  # of wall time since its process was started


class Estimate:
    """Remaining wall time. A run in progress is followed by its steps; one that waits is expected to take as
    long as those of its condition, else as all others: those that ended, else those in progress."""

    def __init__(self, todo: list[RunConfig], workers: int) -> None:
        self._left, self._workers = list(todo), workers
        self._ended: dict[str, list[float]] = {}  # by condition, seconds of the runs that this sweep recorded
        self._first: dict[RunConfig, Step] = {}  # of the runs in progress
        self._latest: dict[RunConfig, Step] = {}

    def stepped(self, step: Step) -> None:
        """Take note of a step."""
        self._first.setdefault(step.config, step)
        self._latest[step.config] = step

    def ended(self, outcome: Outcome) -> None:
        """Take note of an ended run; how long a failing one took tells nothing about the others."""
        self._left.remove(outcome.config)
        self._first.pop(outcome.config, None)
        self._latest.pop(outcome.config, None)
        if outcome.failure is None:
            self._ended.setdefault(outcome.config.condition, []).append(outcome.seconds)

    def _pace(self, config: RunConfig) -> float | None:
        """Return the seconds per step of a run in progress, its start left out; None before its second
        sign."""
        first, latest = self._first.get(config), self._latest.get(config)
        if first is None or latest is None or latest.step <= first.step:
            return None
        return (latest.seconds - first.seconds) / (latest.step - first.step)

    def seconds(self) -> float | None:
        """Return the seconds left, None while nothing is known."""
        paces = {config: pace for config in self._left if (pace := self._pace(config)) is not None}
        known = {condition: list(values) for condition, values in self._ended.items()}
        for config, pace in paces.items():
            if config.condition not in self._ended:
                whole = self._first[config].seconds + pace * config.steps
                known.setdefault(config.condition, []).append(whole)
        if self._left and not known:
            return None
        common = mean(value for values in known.values() for value in values) if known else 0.0
        total = 0.0
        for config in self._left:
            if config in paces:
                total += paces[config] * (config.steps - self._latest[config].step)
            else:
                total += mean(known.get(config.condition, [common]))
        return total / max(1, min(self._workers, len(self._left)))

    def text(self) -> str:
        """Return "about N min left", or that it is not known yet."""
        seconds = self.seconds()
        return "time left not known yet" if seconds is None else f"about {seconds / 60:.0f} min left"

    def running(self) -> str:
        """Return the runs in progress, each with the percentage of its steps."""
        return ", ".join(
            f"{run_name(config)} {100 * latest.step // config.steps} %"
            for config, latest in self._latest.items()
        )


def run_name(config: RunConfig) -> str:
    """Return "SHAPE CONDITION seed SEED"."""
    return f"{called(config)} {config.condition} seed {config.seed}"
