"""Training: `train` makes one run and its record, `sweep` a table of them."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from paper_artifact.catalogue import BASELINE, CONDITIONS, get_condition, shape_row, study_config
from paper_artifact.cli.bars import bar, step_bar
from paper_artifact.cli.options import Positional, Source, WrongUsage, usage_checked, words_of
from paper_artifact.cli.output import next_command, next_mesh
from paper_artifact.cli.reading import OwnSceneOptions
from paper_artifact.cli.verify import recorded_runs, report_differences
from paper_artifact.config import DEVICES, STEPS_OF_THE_STUDY, LossConfig, RunConfig, parse_changes
from paper_artifact.errors import InputError
from paper_artifact.files import OWN, RESULTS, partial_folder
from paper_artifact.mesh import FEATURES, betti_text
from paper_artifact.scene.shapes import is_named
from paper_artifact.study.studies import STUDIES, study_configs

if TYPE_CHECKING:
    from paper_artifact.study.sweep import Outcome

ARGUMENTS = ("shape", "condition", "seed", "steps", "loss", "allocation", "given")  # not taken by --set
DESCRIBED = [f"{each.name} ({each.description})" for each in CONDITIONS]
SET = ", ".join(field.name for field in fields(RunConfig) if field.name not in ARGUMENTS)
LOSS = ", ".join(field.name for field in fields(LossConfig))


@dataclass(frozen=True, kw_only=True)
class Train(OwnSceneOptions):
    """Options of `train`.

    shape: an analytic shape, the key of an external mesh, or a mesh file
    condition: what is added to the photometric loss: {DESCRIBED}
    seed: of everything random
    steps: of training
    changes/set NAME=VALUE: change another setting of the run, e.g. --set vertex_lr=0.006 --set budget=900;
        settings: {SET}
    loss NAME=VALUE: change a setting of the condition's loss, e.g. --loss rho=0.2 --loss samples=8192
        --loss dimensions=1,2; samples=auto with --betti; settings: {LOSS}
    betti B0,B1,B2: the shape's stated Betti numbers, for T1 to T3: components, loops, voids, e.g. 1,2,1
        for a torus (default: the study's, for a shape of the study)
    strict: stop where the images contradict --betti, or end in an error where the finished soup does, instead
        of a warning
    results: folder for record, soup, scene and checkpoint (default: results/; for one's own mesh or scene
        results/own/, which git ignores)
    device: one of {DEVICES}
    threads: CPU threads; the result does not depend on it
    again: run even if there is a record of this configuration, and replace it, unless it was changed
    verify: train again elsewhere and compare with the record: the same bits, or the first value that differs
    """

    shape: Positional[Source | None] = None
    condition: str = BASELINE
    seed: int = 0
    steps: int = STEPS_OF_THE_STUDY
    changes: list[str] = field(default_factory=list)
    loss: list[str] = field(default_factory=list)
    betti: str | None = None
    strict: bool = False
    results: Path | None = None
    device: Annotated[str, DEVICES] = "auto"
    threads: Annotated[int, 1] = 1
    again: bool = False
    verify: bool = False

    @property
    def config(self) -> RunConfig:
        """The configuration that is asked for. Raises WrongUsage for what is unknown or out of range."""
        given = self.given
        if (self.shape is None) == (given is None):
            raise WrongUsage("give either a shape (or a mesh file) or --scene DIR; see --help")
        with usage_checked():
            changes = parse_changes(self.changes, "--set")
            for name in set(changes) & {*ARGUMENTS}:
                raise WrongUsage(
                    f"--set: {name} has an argument of its own or is the condition's; see --help"
                )
            loss = parse_changes(self.loss, "--loss")
            if self.betti is not None:
                if "betti" in loss:
                    raise WrongUsage("--betti and --loss betti are one setting; give one of them")
                loss |= parse_changes([f"betti={self.betti}"], "--betti")
            subject = self.scene or self.shape or ""
            config = study_config(subject, self.condition, self.seed, loss=loss, steps=self.steps, **changes)
        return replace(config, given=given)


def audited(config: RunConfig, given: Iterable[str]) -> RunConfig:
    """Return `config` with the M and the dimensions that the audit's rule finds for a mesh outside the study.

    Unchanged for a shape of the study, for no loss, and where samples or dimensions are among the loss
    settings `given`. Of a scene, its target's mesh decides; a bundle has both. For stated Betti numbers the M
    is left to the SfM cloud (`choose_density`). Says why on stderr. Raises InputError when nothing is
    measurable.
    """
    loss, chosen = config.loss, {"samples", "dimensions"} & {*given}
    shape = config.shape if config.given is None else config.given.target
    if loss is None or (shape is not None and shape_row(shape)):
        return config
    if loss.kind == "betti":
        return config if "samples" in chosen else replace(config, loss=replace(loss, samples=0))
    if chosen or shape is None or shape.endswith(".json"):
        return config
    from paper_artifact.audit.measure import audit_mesh
    from paper_artifact.audit.rule import WORKING
    from paper_artifact.scene.shapes import find_mesh

    mesh = find_mesh(shape, welded=False)
    decision = audit_mesh(mesh, densities=WORKING, first_seed=loss.bundle_seed).decision
    if decision.samples is None:
        why = next((each for each in decision.reasons if each.startswith("Only")), decision.reasons[-1])
        raise InputError(
            f"nothing of {shape} is measurable at M = {' or '.join(map(str, WORKING))}: {why} "
            f"Train it with condition {BASELINE}, or give an M of your own with --loss samples=M"
        )
    print(*decision.reasons, sep="\n", file=sys.stderr)
    return replace(config, loss=replace(loss, samples=decision.samples, dimensions=decision.dimensions))


def trained(options: Train) -> tuple[dict, Path, Path, bool]:
    """Return (record, its path, its soup's path, whether anything ran) of what is asked for."""
    import torch

    from paper_artifact.pipeline import results_of
    from paper_artifact.pipeline import run as run_config
    from paper_artifact.raster.threads import set_thread_count
    from paper_artifact.record.store import config_of, record_path
    from paper_artifact.scene.given import called
    from paper_artifact.train.state import TrainingError

    config = audited(options.config, [text.partition("=")[0] for text in options.loss])
    set_thread_count(options.threads)
    torch.set_num_threads(1)
    with step_bar(f"{called(config)} {config.condition}", config.steps, options.quiet) as line:
        try:
            record = run_config(
                config,
                results=options.results,
                progress=line.progress,
                device=options.device,
                again=options.again,
                strict=options.strict,
                tell=lambda text: line.write(text, file=sys.stderr),
            )
        except TrainingError as error:
            raise InputError(str(error)) from error
    done = config_of(record)
    results = options.results or results_of(done)
    path = record_path(done, results / "runs", record["defaults"])
    return record, path, results / "soups" / f"{path.stem}.npz", line.seen


def train(options: Train) -> int:
    """Train (or find the record) and print the result. Returns 0, or 1 where --verify finds a difference."""
    from paper_artifact.pipeline import audit_remarks, results_of
    from paper_artifact.soup.state import load_soup

    if options.verify:
        if options.again:
            raise WrongUsage("--again replaces the record that --verify compares with; give one of them")
        config = audited(options.config, [text.partition("=")[0] for text in options.loss])
        recorded = recorded_runs([config], options.results or results_of(config))
        with partial_folder() as temporary:
            _, path, _, _ = trained(replace(options, results=temporary))
            return report_differences(recorded, [path])
    record, path, soup, ran = trained(options)
    if not ran:
        print("nothing ran: the record exists already (--again trains anew)")
    print(summary(record))
    said = [f"warning: {each}" for each in audit_remarks(record, "warnings")]
    said += [f"note, when the loss set in: {each}" for each in audit_remarks(record, "notes")]
    said += [f"note, at the end: {each}" for each in closing_notes(record)]
    print(*said, sep="\n", end="\n" * bool(said))
    print(f"record: {path}")
    if not soup.is_file():
        print(f"warning: the soup {soup} is gone; --again trains it anew", file=sys.stderr)
        return 0
    if not ran:
        load_soup(soup)  # refused where it is damaged
    print(f"soup: {soup}", _after(soup, options.shape, options.scene, options.betti), sep="\n")
    return 0


def _after(soup: Path, shape: str | None, scene: str | None, betti: str | None) -> str:
    """Return the line of what comes next for a soup of a shape or mesh, or of a scene."""
    if scene is None and (shape is None or not Path(shape).is_dir()):
        return next_command("export", soup, "--target", shape)
    stated = [] if betti is None else ["--betti", betti]
    return next_mesh("solidify", soup, "--scene", scene or shape, *stated)


def closing_notes(record: dict) -> list[str]:
    """Return `topology.statement.ended` of a record of stated Betti numbers, nothing of another."""
    from paper_artifact.record.store import config_of
    from paper_artifact.topology.statement import Statement, ended

    loss, said = config_of(record).loss, record.get("statement")
    given = None if said is None else Statement(tuple(said["betti"]), said["diagonal"])
    return [] if loss is None or given is None else ended(given, record.get("topology") or (), loss)


def summary(record: dict) -> str:
    """Return a record's main numbers, one line."""
    tails, images = record["tails"], record["images"]
    parts = [f"{record['config']['shape']} {record['config']['condition']} seed {record['config']['seed']}"]
    if tails and "mesh" not in record:
        parts.append(_alone_text(record["dumps"][-1]))
    elif tails:
        dimension, (components, loops, voids) = record["mesh"]["dimension"], tails["counts"]
        parts += [
            f"tail bottleneck of {FEATURES[dimension][1]} {tails['bottleneck'][dimension]:.4f}",
            betti_text((components + 1, loops, voids)),
            f"Chamfer {100 * tails['chamfer']:.3f} %",
        ]
    if images.get("psnr") is not None:
        parts.append(f"held-out PSNR {images['psnr']:.2f} dB, SSIM {images['ssim']:.4f}")
    parts += [f"{record['soup']['triangles']} triangles", f"{record['cpu_seconds']:.0f} s of CPU"]
    return "; ".join(parts)


def _alone_text(dump: dict) -> str:
    """Return what a soup shows without a ground truth (`evaluate_alone`): per dimension the number of
    features, how many floors the shortest of them has, and the longest bar below."""
    parts = []
    for dimension, (count, margins) in enumerate(zip(dump["counts"], dump["margins"], strict=True)):
        number, (one, more) = count + (dimension == 0), FEATURES[dimension]
        kept = [f"{margins[count - 1]:.2f} floors"] if 0 < count <= len(margins) else []
        kept += [f"next {margins[count]:.2f}"] if count < len(margins) else []
        parts.append(f"{number} {one if number == 1 else more} ({', '.join(kept) or 'many'})")
    return ", ".join(parts)


@dataclass(frozen=True, kw_only=True)
class Sweep(OwnSceneOptions):
    """Options of `sweep`.

    study STUDY|MESH: {STUDIES} (paper_artifact/study/studies.py); or what train takes, a mesh or --scene,
        under every condition with every seed
    shape: only this shape of the study (may be given several times)
    condition: only this condition (may be given several times)
    seed: only this seed (may be given several times)
    workers: runs at the same time, one process and one thread each
    results DIR: folder with runs/ (default: results/, results/own/ for one's own mesh or scene)
    device: one of {DEVICES}
    executor: where they run
    scheduler ADDRESS: of the Dask scheduler (tcp://host:8786), with --executor dask
    steps: of each run, of a mesh or scene
    betti B0,B1,B2: for T1 to T3, of a mesh or scene
    changes/set NAME=VALUE: change any other setting, of a mesh or scene
    listing/list: only say what is recorded and what is missing
    verify: train what is recorded again elsewhere and compare: the same bits, or the first value that differs
    """

    study: Positional[Source | None] = None
    shape: list[str] = field(default_factory=list)
    condition: list[str] = field(default_factory=list)
    seed: list[int] = field(default_factory=list)
    workers: Annotated[int, 1] = 1
    results: Path | None = None
    device: Annotated[str, DEVICES] = "cpu"
    executor: Annotated[str, ("process", "dask")] = "process"
    scheduler: str | None = None
    steps: int | None = None
    betti: str | None = None
    changes: list[str] = field(default_factory=list)
    listing: bool = False
    verify: bool = False

    @property
    def configs(self) -> list[RunConfig]:
        """The runs of a study, or of one mesh or scene: every condition with every seed.

        Raises WrongUsage for what is unknown, out of range or belongs to the other.
        """
        if (self.study is None) == (self.given is None):
            raise WrongUsage("give either a study (or a mesh file) or --scene DIR; see --help")
        if self.study in STUDIES:
            if self.steps is not None or self.betti is not None or self.changes:
                raise WrongUsage(
                    "--steps, --betti and --set go with a mesh or --scene; a study's rows have its settings"
                )
            with usage_checked():
                return study_configs(
                    self.study, self.shape or None, self.condition or None, self.seed or None
                )
        if self.study is not None and not (is_named(self.study) or Path(self.study).exists()):
            known = ", ".join(STUDIES)
            raise WrongUsage(f"unknown study {self.study!r}; choose one of {known}, or an existing mesh file")
        if self.shape:
            raise WrongUsage("--shape restricts a study; with a mesh or --scene leave it out")
        own = {each.name: getattr(self, each.name) for each in fields(OwnSceneOptions)}
        steps = {} if self.steps is None else {"steps": self.steps}
        own |= steps | {"shape": self.study, "changes": self.changes}
        conditions = dict.fromkeys(self.condition or [BASELINE])
        with usage_checked():
            stated = [name for name in conditions if getattr(get_condition(name).loss, "kind", "") == "betti"]
        if self.betti is not None and not stated:
            raise WrongUsage(f"--betti is for T1 to T3, not {', '.join(conditions)}; add --condition T3")
        found: list[RunConfig] = []
        for name in conditions:
            betti = self.betti if name in stated else None
            one = audited(Train(condition=name, betti=betti, **own).config, ())  # once, not once a seed
            with usage_checked():
                found += [replace(one, seed=seed) for seed in dict.fromkeys(self.seed or [0])]
        return found


def sweep(options: Sweep) -> int:
    """Run the sweep and report failures at the end. Returns 0, or 1 when a run failed or, with --verify, gave
    other bits."""
    from paper_artifact.scene.given import is_own
    from paper_artifact.study.sweep import missing, run_name

    if (options.executor == "dask") != bool(options.scheduler):
        raise WrongUsage("--executor dask and --scheduler ADDRESS belong together; give both or neither")
    configs = options.configs
    results = options.results or (OWN if all(map(is_own, configs)) else RESULTS)
    if options.listing:
        todo = missing(configs, results)
        for config in todo:
            print(f"missing: {run_name(config)}")
        print(f"{len(configs) - len(todo)} of {len(configs)} runs recorded")
        if todo:
            print(next_command("sweep", *words_of(options, "listing")))
        return 0
    if options.verify:
        todo = missing(configs, results)
        configs = [config for config in configs if config not in todo]
        recorded = recorded_runs(configs, results)
        with partial_folder() as temporary:
            failures = _swept(options, configs, temporary)
            if failures:
                return 1
            different = report_differences(recorded, recorded_runs(configs, temporary))
        print(f"{len(configs)} runs compared, {len(todo)} have no record")
        return different
    if _swept(options, configs, results):
        return 1
    if options.study in STUDIES:
        print(
            next_command("run-all")
            if results == RESULTS
            else next_command("book", "--runs", results / "runs")
        )
    else:
        soup = results / "soups" / f"{recorded_runs(configs[-1:], results)[0].stem}.npz"
        if soup.is_file():
            print(_after(soup, options.study, options.scene, options.betti))
    return 0


def _swept(options: Sweep, configs: list[RunConfig], results: Path) -> list[Outcome]:
    """Make the runs that have no record in results/runs, print how it went, and return what failed."""
    from paper_artifact.study.sweep import run_name
    from paper_artifact.study.sweep import sweep as run_sweep

    # Without tqdm's own time left, which knows nothing of the steps.
    layout = "{desc} |{bar:20}| {n_fmt}/{total_fmt} runs [{elapsed}]"
    with bar(total=1, disable=options.quiet, bar_format=layout) as line:

        def report(text: str, ended: int, total: int) -> None:
            line.total = total
            line.set_description(text, refresh=False)
            line.update(ended - line.n)
            line.refresh()

        outcomes = run_sweep(
            configs,
            results,
            workers=options.workers,
            device=options.device,
            scheduler=options.scheduler,
            report=report,
        )
    failures = [outcome for outcome in outcomes if outcome.failure]
    before = len(configs) - len(outcomes)
    print(f"{len(outcomes) - len(failures)} runs done, {before} were recorded before, {len(failures)} failed")
    for outcome in failures:
        print(f"  {run_name(outcome.config)}: {outcome.failure}")
    return failures
