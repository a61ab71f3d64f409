"""Notebook 18: the mug's truth is what it says, and the tables come from model and measurement."""

from __future__ import annotations

import pandas as pd

from paper_artifact.certify.certificate import certify_mesh
from paper_artifact.report import photographs


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


def test_a_measurement_becomes_a_table_and_a_missing_one_its_command():
    row = {"condition": "C0", "psnr": 20.0, "ssim": 0.9, "triangles": 9, "on_the_mug": 5, "cpu": 1.0}
    row |= {"chamfer": 0.01, "hausdorff95": 0.02}
    row |= {f"{name}_{k}": k for name in ("count", "target", "bottleneck") for k in range(3)}
    table = photographs.result_table(pd.DataFrame([row]))
    assert table.loc["C0", "significant bars"] == "(0, 1, 2)" and table.loc["C0", "Chamfer, % of D"] == 1.0
    assert "measure photographs" in photographs.result_table(pd.DataFrame()).iloc[0, 0]
