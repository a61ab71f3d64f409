"""Notebook 18: the mug's truth is what it says, and the tables come from model and measurement."""

from __future__ import annotations

import numpy as np
import pandas as pd

from paper_artifact.certify.certificate import certify_mesh
from paper_artifact.report import measured, photographs


def test_the_ground_truth_is_one_closed_surface_of_genus_one():
    certificate = certify_mesh(photographs.mug())
    assert certificate.betti == (1, 2, 1) and certificate.open_edges == 0
    size = sum(file.stat().st_size for file in photographs.FOLDER.rglob("*") if file.is_file())
    assert size < 3e6


def test_the_committed_model_stands_where_the_cameras_truly_stood():
    found, missed = photographs.alignment()
    assert missed.max() < 0.3  # centimetres, at 27 from the mug
    table = photographs.registration_table()["value"]
    assert int(table["registered"]) == int(table["photographs"]) >= 40
    assert float(table["points off the mug, median, millimetres"]) < 1


def row_of(condition: str, seed: int, loop: float, offset: float) -> dict:
    row = {"condition": condition, "seed": seed, "psnr": 20.0 + seed, "psnr_rays": 21.0, "ssim": 0.9}
    row |= {"triangles": 9, "on_the_mug": 5, "cpu": 1.0, "chamfer": 0.01, "hausdorff95": 0.02}
    row |= {f"{name}_{k}": k for name in ("count", "target", "bottleneck") for k in range(3)}
    row |= {"offsets": "0.02/0.03", "genus": "4/1", "components": "2/1"}
    return row | {"bottleneck_1": loop, "solid_offset": offset, "solid_chamfer": 0.02}


def test_a_measurement_becomes_tables_and_a_missing_one_its_command():
    rows = [row_of("C0", 0, 0.01, 0.03), row_of("C0", 1, 0.02, np.nan), row_of("T1", 0, 0.04, 0.03)]
    made = pd.DataFrame(rows)
    table = photographs.result_table(made)
    assert table.loc["C0", "significant bars"] == "(0, 1, 2) (0, 1, 2)"
    assert table.loc["C0", "held-out PSNR, dB"] == "20.50 (20.00 … 21.00)"
    assert table.loc["T1", "Chamfer, % of D"] == "1.000"
    solids = photographs.solid_table(made)
    assert solids.loc[("C0", 0)].tolist() == ["4 in 2", "1", "0.03", "2.00"]
    assert solids.loc[("C0", 1), "taken"] == "none" and solids.loc[("C0", 1), "Chamfer, % of D"] == ""
    text = photographs.result_text(made)
    assert "bottleneck of the handle's loop 2.67 times; in every seed the loop is worse" in text
    assert "C0 1 of 2 (smallest ε 0.03/none), T1 1 of 1" in text
    assert "measure photographs" in photographs.result_table(pd.DataFrame()).iloc[0, 0]
    assert "not measured yet" in photographs.result_text(made[:2])


def test_the_committed_measurement_is_of_every_arm_and_seed():
    stored = measured.read("photographs")
    assert set(zip(stored["condition"], stored["seed"], strict=True)) == {
        (arm, seed) for arm in photographs.ARMS for seed in photographs.SEEDS
    }
    assert set(stored["offsets"]) == {"/".join(f"{offset:g}" for offset in photographs.OFFSETS)}
    # A solid that was taken has genus 1 in one piece at that offset, and at no smaller one.
    for row in stored.itertuples():
        found = zip(row.genus.split("/"), row.components.split("/"), photographs.OFFSETS, strict=True)
        sound = [offset for genus, count, offset in found if (genus, count) == ("1", "1")]
        assert (min(sound) == row.solid_offset) if sound else np.isnan(row.solid_offset)
    assert photographs.PICTURE.stat().st_size < 5e5
