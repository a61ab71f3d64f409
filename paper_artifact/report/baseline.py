"""Notebook 01: the baseline reconstruction (condition C0): renders, checks, trajectories, ours beside the
paper's."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

from paper_artifact.catalogue import BASELINE, shape_row, study_config
from paper_artifact.errors import InputError
from paper_artifact.evaluate.image import image_scores
from paper_artifact.export.figures import PAGE, new_figure
from paper_artifact.export.flat import upright
from paper_artifact.mesh import Mesh
from paper_artifact.pipeline import prepare_scene, run
from paper_artifact.raster.view import ViewRaster, make_camera
from paper_artifact.report.kit import frames
from paper_artifact.report.kit.figures import (
    MARKS,
    SERIES,
    draw_band,
    image_rows,
    label_axis,
    legend_below,
    mark_value,
    plain_log,
)
from paper_artifact.report.kit.records import RETRAINED, Collected, collect, command, key, soup_path
from paper_artifact.report.kit.text import blank
from paper_artifact.scene.cameras import CAMERA_DISTANCE, FAR, NEAR, Camera, look_at, world_to_clip
from paper_artifact.scene.find import find_mesh
from paper_artifact.scene.ground_truth import background_colour, render_ground_truth
from paper_artifact.soup.render import render_views
from paper_artifact.soup.state import Soup, load_soup

# What a short run of 300 steps reaches with a wide margin. Only "above or below" is compared between
# machines: compiled kernels may differ in the last bit between kinds of CPU, and training amplifies that.
FALL, PSNR, SSIM, CHAMFER = 0.5, 20.0, 0.75, 1.5  # loss, last / first tenth; dB; no unit; percent of D
NEARER = 0.78  # of the scenes' camera distance: the shape fills the picture


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """One trained soup beside its ground truth."""

    shape: str
    record: dict  # of the run
    soup: Soup
    truth: np.ndarray  # held-out views (m,H,W,3) float32 in [0,1]
    renders: np.ndarray  # the soup's, likewise

    def scores(self) -> dict[str, float]:
        """Return PSNR (dB) and SSIM over the held-out views, and Chamfer in percent of D."""
        return image_scores(self.renders, self.truth) | {"chamfer": 100 * self.record["dumps"][-1]["chamfer"]}


def reconstruct(
    shapes: Sequence[str], profile: str, seed: int, steps: int, size: int
) -> tuple[Reconstruction, ...]:
    """Train C0 on each shape and return the soups with their held-out views.

    profile "recorded": short runs of `steps` steps on `size` px views in a temporary folder (seconds);
    "full": the study's runs (2,500 steps, 200 px), kept in results/retrained. Raises InputError for an
    unknown shape or a mesh that cannot be had.
    """
    made = []
    short = {} if profile == "full" else {"steps": steps, "size": size, "dump_steps": (steps,)}
    for shape in shapes:
        mesh, config = find_mesh(shape), study_config(shape, seed=seed, **short)
        with tempfile.TemporaryDirectory(prefix="paper_artifact-") as temporary:
            results = RETRAINED if profile == "full" else Path(temporary)
            record = run(config, mesh=mesh, results=results)
            scene = prepare_scene(config, mesh, results / "scenes")
            soup = load_soup(soup_path(record, results))
            renders = render_views(soup, scene, scene.holdout)
        made.append(Reconstruction(shape, record, soup, scene.colours(scene.holdout), renders))
    return tuple(made)


def check_table(runs: Iterable[Reconstruction]) -> pd.DataFrame:
    """Return per run what holds on every machine: prunings that met the budget (splitting adds a few), and
    each bound above passed or not."""
    rows = {}
    for each in runs:
        loss, config, scores = np.asarray(each.record["losses"]["loss"]), each.record["config"], each.scores()
        part = max(len(loss) // 10, 1)
        pruned = [step["pruned"] for step in each.record["soup"]["resamplings"]]
        rows[each.shape] = {
            "steps": config["steps"],
            "pixels": config["size"],
            "budget": config["budget"],
            "every pruning met the budget": max(pruned, default=0) <= config["budget"],
            f"loss fell below {FALL:g}× its start": bool(loss[-part:].mean() < FALL * loss[:part].mean()),
            f"held-out PSNR > {PSNR:g} dB": scores["psnr"] > PSNR,
            f"held-out SSIM > {SSIM:g}": scores["ssim"] > SSIM,
            f"Chamfer < {CHAMFER:g} %": scores["chamfer"] < CHAMFER,
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("shape")


def measured_table(runs: Iterable[Reconstruction]) -> pd.DataFrame:
    """Return the same runs' measured numbers (PSNR, SSIM, Chamfer, triangles, CPU seconds): for a cell
    that is not compared."""
    rows = {}
    for each in runs:
        scores = each.scores()
        rows[each.shape] = {
            "triangles": len(each.soup),
            "held-out PSNR dB": round(scores["psnr"], 2),
            "held-out SSIM": round(scores["ssim"], 4),
            "Chamfer %": round(scores["chamfer"], 3),
            "CPU s": each.record["cpu_seconds"],
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("shape")


def kept_views(shapes: Sequence[str], seed: int = 0, views: int = 6, size: int = 200) -> dict[str, tuple]:
    """Return per shape (truth, renders), each (views,size,size,3) in [0,1]: ground truth and the committed
    soup of its full-length C0 run, from cameras that stand upright about the shape (the catalogue's `up`; the
    run's own have z upwards): views that training never saw.

    Raises InputError where the run is not recorded or its soup is not kept.
    """
    pictures = {}
    for shape in shapes:
        found, mesh = collect([(shape, BASELINE, seed)]), find_mesh(shape)
        path = soup_path(found.records[0], found.results) if found.records else None
        if path is None or not path.is_file():
            raise InputError(
                f"no soup of {shape} {BASELINE}, seed {seed}, is kept; {command(shape, BASELINE, seed)}"
            )
        turn, background = upright(np.asarray(shape_row(shape).up)), background_colour("white")
        soup, raster = load_soup(path).drawn(), ViewRaster(size, size)
        truth, renders = [], []
        for camera in ring_cameras(mesh, turn, views, size):
            matrix = world_to_clip(camera, NEAR * mesh.radius, FAR * mesh.radius)
            truth.append(render_ground_truth(mesh, camera, background))
            renders.append(raster.render(soup, make_camera(matrix), background).copy().transpose(1, 2, 0))
        pictures[shape] = np.stack(truth), np.stack(renders)
    return pictures


def ring_cameras(mesh: Mesh, turn: np.ndarray, count: int, size: int) -> list[Camera]:
    """Return cameras around a mesh, nearer than the scenes' own and a little above its middle; `turn` (3,3)
    takes the mesh's upward direction to z."""
    middle, cameras = turn @ mesh.centre, []
    for angle in 2 * np.pi * (np.arange(count) + 0.5) / count:
        direction = np.array([np.cos(angle), np.sin(angle), 0.45])
        place = middle + NEARER * CAMERA_DISTANCE * mesh.radius * direction / np.linalg.norm(direction)
        camera = look_at(place, middle, size)
        pose = Rotation.from_matrix(camera.rotation @ turn).as_quat(scalar_first=True)
        cameras.append(replace(camera, quaternion=tuple(float(each) for each in pose)))
    return cameras


def views_figure(pictures: Mapping[str, tuple]) -> Figure:
    """Return the views of `kept_views`, ground truth above the trained soup, for every shape."""
    rows = []
    for shape, (truth, renders) in pictures.items():
        rows += [(f"{shape}: truth", truth), (f"{shape}: soup", renders)]
    return image_rows(rows)


def view_table(pictures: Mapping[str, tuple]) -> pd.DataFrame:
    """Return per shape how many views there are, their pixels, and the soup's PSNR (dB) and SSIM in them."""
    rows = {}
    for shape, (truth, renders) in pictures.items():
        scores = image_scores(renders, truth)
        rows[shape] = {
            "views": len(truth),
            "pixels": truth.shape[1],
            "PSNR dB": round(scores["psnr"], 1),
            "SSIM": round(scores["ssim"], 2),
        }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("shape")


def seed_table(collected: Collected) -> pd.DataFrame:
    """Return one line per recorded run: tail (mean of the last three dumps, in the judged dimension),
    counts (H0, H1, H2 at the end), Chamfer, held-out PSNR and SSIM, triangles."""
    records, rows = {key(record): record for record in collected.records}, []
    for run_ in frames.runs(collected).itertuples():
        record = records[run_.shape, run_.condition, run_.seed]
        rows.append(
            {
                "shape": run_.shape,
                "seed": run_.seed,
                "dimension": f"H{run_.dimension}",
                "tail": round(run_.tail, 4),
                "counts": str(tuple(record["tails"]["counts"])),
                "Chamfer %": round(100 * run_.chamfer, 3),
                "PSNR dB": round(record["images"]["psnr"], 2),
                "SSIM": round(record["images"]["ssim"], 4),
                "triangles": record["soup"]["triangles"],
            }
        )
    return pd.DataFrame(rows)


def trajectory_figure(collected: Collected) -> Figure:
    """Return loss, Chamfer, bottleneck (in the judged dimension) and triangles over training: one line per
    shape (mean of seeds), band: range of seeds; dashed: the budgets."""
    figure, axes = new_figure(2, 2, PAGE / 2, 2.1)
    dumps = frames.dumps(collected)
    panels = (
        (_losses(collected), "loss", "photometric loss (no unit)"),
        (dumps, "chamfer %", "Chamfer (% of D)"),
        (dumps, "bottleneck", "bottleneck (radius / D)"),
        (_triangles(collected), "triangles", "triangles"),
    )
    budget = None
    for axis, (table, value, words) in zip(axes.flat, panels, strict=True):
        label_axis(axis, "", "step", words)
        if value in ("loss", "triangles") and len(table):
            plain_log(axis)
        for number, shape in enumerate(dict.fromkeys(table["shape"])):
            style = {"marker": MARKS[number] if table is dumps else "", "markevery": (number % 2, 2)}
            style["linewidth"] = max(2.6 - 0.7 * number, 1.0)  # lines on one another all show
            draw_band(axis, table[table["shape"] == shape], value, shape, SERIES[number], **style)
    for each in sorted({record["config"]["budget"] for record in collected.records}):
        budget = mark_value(axes[1][1], each)
    if budget is not None:
        budget.set_label("budget N")
        for axis in (axes[0][1], axes[1][0]):
            axis.set_ylim(bottom=0)
        for axis, ticks in (
            (axes[0][0], (0.003, 0.01, 0.03, 0.1, 0.3)),
            (axes[1][1], (500, 1000, 2000, 5000, 10_000)),
        ):
            low, high = axis.get_ylim()
            axis.set_yticks([each for each in ticks if low <= each <= high])
            axis.set_ylim(low, high)
    legend_below(figure, 5)
    return figure


def _triangles(collected: Collected) -> pd.DataFrame:
    """One row per record and resampling: shape, seed, step and the triangles left; first the start's."""
    rows = []
    for record in collected.records:
        shape, _, seed = key(record)
        taken = record["soup"]["resamplings"]
        counts = [(0, each["before"]) for each in taken[:1]] + [
            (each["step"], each["after"]) for each in taken
        ]
        rows += [{"shape": shape, "seed": seed, "step": step, "triangles": count} for step, count in counts]
    return pd.DataFrame(rows, columns=["shape", "seed", "step", "triangles"])


def _losses(collected: Collected) -> pd.DataFrame:
    """One row per record and kept step: shape, seed, step and the photometric loss."""
    parts = [
        pd.DataFrame(record["losses"]).assign(shape=record["config"]["shape"], seed=record["config"]["seed"])
        for record in collected.records
    ]
    return pd.concat(parts) if parts else pd.DataFrame(columns=["shape", "seed", "step", "loss"])


def trajectory_table(collected: Collected) -> pd.DataFrame:
    """Return what the trajectories show: per shape and dump step the seeds' mean bottleneck, significant
    counts and Chamfer."""
    grouped = frames.dumps(collected).groupby(["shape", "step"], sort=False)
    columns = {
        "bottleneck": grouped["bottleneck"].mean().round(4),
        "counts": grouped["count"].agg(lambda counts: "/".join(map(str, counts))),
        "Chamfer %": grouped["chamfer %"].mean().round(3),
    }
    return pd.DataFrame(columns).unstack("shape").swaplevel(axis=1).sort_index(axis=1, level=0)


def beside_paper(collected: Collected) -> pd.DataFrame:
    """Return per shape ours beside the paper's: tail mean and sd (n - 1) over seeds, ours / paper's, and
    Chamfer where the paper prints one."""
    arms = frames.arms(collected).dropna(subset="mean").set_index(frames.ARM)
    paper = frames.paper_arms().set_index(frames.ARM).reindex(arms.index)
    chamfer = frames.paper_arms("chamfer_percent", "chamfer").set_index(frames.ARM).reindex(arms.index)
    table = pd.DataFrame(
        {
            "dimension": "H" + arms["dimension"].astype(str),
            "seeds": arms["seeds"].map(len),
            "our tail": arms["mean"].round(4),
            "± sd": arms["sd"].round(4),
            "paper's tail": paper["printed"],
            "± sd, paper": paper["sd"],
            "ours / paper's": (arms["mean"] / paper["value"]).round(2),
            "our Chamfer %": (100 * arms["chamfer"]).round(2),
            "paper's Chamfer %": chamfer["printed"],
        }
    )
    return blank(table.droplevel("condition"))
