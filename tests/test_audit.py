"""Audit: the rule against every decision of the paper, bundles that training builds again, the report, and
meshes with nothing to measure.
"""

import json
import re
import shlex
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from paper_artifact.audit.marks import find_marks, light_mesh, view_parts
from paper_artifact.audit.measure import audit_mesh
from paper_artifact.audit.page import audit_page, headline
from paper_artifact.audit.rule import DENSITIES, Rung, decide
from paper_artifact.catalogue import study_config
from paper_artifact.certify.certificate import certify_mesh
from paper_artifact.config import parse_changes
from paper_artifact.errors import InputError
from paper_artifact.evaluate.diagram import measure
from paper_artifact.frame import SAME
from paper_artifact.mesh import Mesh, checked_mesh
from paper_artifact.pipeline import make_run_bundle
from paper_artifact.randomness import stream
from paper_artifact.sampling import sample_surface
from paper_artifact.scene.shapes import find_mesh
from paper_artifact.soup.initialise import initial_soup
from paper_artifact.soup.state import save_soup
from paper_artifact.topology.bundle import load_bundle
from paper_artifact.topology.floor import measurement_floor
from tests import certify_shapes as shapes

SMALL = {"densities": (256, 512), "working": (256, 512)}
CLOSED = certify_mesh(Mesh(*shapes.ball(), "mesh"))
OPEN = certify_mesh(Mesh(*shapes.bowl(), "mesh"), with_boundary=True)


def rung(samples: int, h0: int, h1: int, h2: int, margin: float = 1.5) -> Rung:
    """A rung with that signature (H0 with its infinite bar)."""
    return Rung(samples, 0, 0.05, tuple((margin,) * count + (0.4,) for count in (h0 - 1, h1, h2)))


# shape: certified Betti numbers, signatures at M = 2048, 4096, 8192, 20000 (Tables S3, S5, S11), class,
# M, dimensions, complete
STUDY = {
    "sphere": ((1, 0, 1), ["101", "101", "101", "101"], 2, 2048, (2,), True),
    "torus": ((1, 2, 1), ["120", "121", "121", "121"], 1, 2048, (1,), True),
    "two_spheres": ((2, 0, 2), ["202", "202", "202", "202"], 0, 2048, (0, 2), True),
    "bob": ((1, 2, 1), ["121", "121", "121", "121"], 1, 2048, (1, 2), True),
    "rocker-arm": ((1, 2, 1), ["110", "111", "112", "122"], 1, 2048, (1,), False),
    "eight": ((1, 4, 1), ["121", "141", "141", "141"], 1, 8192, (1, 2), True),
    "pot": ((1, 6, 1), ["100", "100", "101", "101"], 2, 8192, (2,), True),
    "spot": ((1, 0, 1), ["101", "102", "102", "102"], 2, 2048, (2,), True),
    "armadillo": ((1, 0, 1), ["101", "101", "101", "101"], 2, 2048, (2,), True),
    "bowls": (None, ["101", "101", "101", "101"], 2, 2048, (2,), True),
}


@pytest.mark.parametrize("shape", STUDY)
def test_the_rule_takes_the_papers_decisions(shape):
    betti, signatures, dimension, samples, dimensions, complete = STUDY[shape]
    certificate = OPEN if betti is None else replace(CLOSED, betti=betti)
    rungs = [rung(m, *map(int, sign)) for m, sign in zip(DENSITIES[2:], signatures, strict=True)]
    for order in (rungs, rungs[::-1]):
        found = decide(order, certificate)
        assert (found.dimension, found.samples) == (dimension, samples)
        assert (found.dimensions, found.complete) == (dimensions, complete)
        assert found.basis == ("observation" if betti is None else "certificate") and found.reasons


def test_more_bars_than_certified_are_a_warning():
    rungs = [rung(2048, 1, 0, 1), rung(4096, 1, 0, 2), rung(8192, 1, 0, 2)]
    first, _ = decide(rungs, CLOSED).warnings
    assert "M = 4096 shows 2 voids where 1 are expected" in first
    tight = [rung(2048, 1, 0, 1, 1.05), rung(8192, 1, 0, 1, 2.0)]
    assert "another sampling seed" in decide(tight, CLOSED).warnings[0]


def test_reasons_count_components_loops_and_voids():
    rungs = [rung(2048, 2, 0, 1), rung(8192, 2, 1, 2)]
    assert decide(rungs, replace(CLOSED, betti=(2, 0, 2))).reasons == (
        "The certificate passes; expected are 2 components, 0 loops, 2 voids.",
        "M = 2048 is the first working density that shows 2 of 2 components (tightest 1.50 of the floor).",
        "Left out: 1 of 2 voids at M = 2048.",
    )
    assert decide(rungs, OPEN).reasons[0].endswith("is expected: 2 components, 1 loop, 2 voids.")
    alone = decide([rung(2048, 1, 0, 1), rung(8192, 1, 0, 1)], replace(CLOSED, betti=(2, 0, 1)))
    assert alone.reasons[1].startswith("Only 1 of 2 components clear")


def test_a_certified_class_that_is_never_measurable_gives_way_to_what_is_seen():
    decision = decide([rung(2048, 1, 0, 0), rung(8192, 1, 2, 0)], CLOSED)
    assert (decision.dimension, decision.samples, decision.basis) == (1, 8192, "observation")


def test_nothing_measurable_is_said():
    decision = decide([rung(2048, 1, 0, 0), rung(8192, 1, 0, 0), rung(20_000, 1, 0, 1)], CLOSED)
    assert decision.dimension is None and decision.samples is None and decision.dimensions == ()
    assert "M = 20000 only" in decision.reasons[-1]
    with pytest.raises(InputError, match="no rung at the working density"):
        decide([rung(2048, 1, 0, 1)], CLOSED)


@pytest.mark.parametrize("seeds", [0, 1001, 10**30])
def test_seeds_without_end_are_refused(seeds):
    with pytest.raises(InputError, match="1 to 1000 seeds"):
        audit_mesh(find_mesh("torus"), densities=(300,), working=(600,), seeds=seeds)


def test_the_command_builds_the_audits_bundle_again():
    audit = audit_mesh(find_mesh("sphere"), "sphere", **SMALL)
    assert audit.decision.dimension == 2 and audit.bundle.samples == audit.decision.samples == 256
    assert [each.partition("--condition ")[2][:2] for each in audit.commands] == ["", "C1", "C2"]
    words = shlex.split(audit.commands[1])
    assert words[:5] == ["python", "-m", "paper_artifact", "train", "sphere"]
    changes = parse_changes([words[i + 1] for i, word in enumerate(words) if word == "--loss"], "--loss")
    config = study_config("sphere", "C1", steps=10, loss=changes)
    bundle = make_run_bundle(config, audit.mesh)
    assert bundle.to_json() == audit.bundle.to_json() and config.budget == 1200
    own = replace(audit, name="my mesh.obj", usual=True)  # `train` applies the rule itself
    assert own.commands[1] == "python -m paper_artifact train 'my mesh.obj' --condition C1"
    loops = replace(own, decision=replace(own.decision, dimension=1))
    assert loops.commands[0] == "python -m paper_artifact train 'my mesh.obj' --set budget=700"


def test_margins_are_those_of_the_bundles_own_samples():
    audit = audit_mesh(find_mesh("torus"), densities=(300,), working=(600,), seeds=2, first_seed=3)
    assert [(each.samples, each.seed) for each in audit.rungs] == [(300, 3), (300, 4), (600, 3), (600, 4)]
    diagram, floor = measure(find_mesh("torus"), 600, 3)
    longest = np.sort(diagram[1][:, 1] - diagram[1][:, 0])[::-1] / floor
    assert audit.rungs[2].margins[1][:2] == pytest.approx(longest[:2], abs=1e-4)
    assert audit.bundle.seed == 3 and audit.bundle.floor == pytest.approx(floor)


def test_the_page_holds_everything_itself():
    audit = audit_mesh(find_mesh("bowl_wide"), "a <b>name</b>", **SMALL)
    page = audit_page(audit)
    assert audit.certificate.kind == "disk" and audit.decision.basis == "observation"
    assert page.startswith("<!DOCTYPE html>") and "<b>name</b>" not in page
    assert "<title>Audit of bowl_wide</title>" in page, "the name, not the path it was given by"
    assert "PASS as a surface with boundary (1 boundary loop; not closed)" in page
    assert page.count("<button>copy</button>") == len(audit.commands) == 3
    assert page.count("data:image/svg+xml;base64,") == page.count("data:image/png;base64,") == 3
    assert "<iframe" in page and "Betti numbers, Z/2" in page
    assert not re.search(r"(src|href)=['\"]?https?:", page)
    assert page == audit_page(audit_mesh(find_mesh("bowl_wide"), "a <b>name</b>", **SMALL))


def test_a_mesh_with_nothing_measurable_gets_a_report_and_no_command(tmp_path, command):
    trimesh.creation.box(extents=(1, 1, 0.001)).export(tmp_path / "sheet.ply")
    line = f"audit {tmp_path}/sheet.ply --densities 128 --working 256 --out {tmp_path}"
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "bundle.json").write_text("somebody's")  # would look like this mesh's
    assert "was not written by this command" in command(f"{line}/other", code=1).err
    printed = command(f"{line}/out").out
    assert "Nothing is measurable" in printed and "C0, the images alone, trains" in printed
    assert f"paper_artifact train {tmp_path}/sheet.ply\n" in printed and "--condition" not in printed
    assert sorted(path.name for path in (tmp_path / "out").glob("[!.]*")) == ["audit.html", "audit.json"]
    stored = json.loads((tmp_path / "out" / "audit.json").read_text())
    assert stored["decision"]["samples"] is None and stored["bundle"] is None
    assert stored["certificate"]["verdict"] == "pass"
    assert "Nothing is measurable" in (tmp_path / "out" / "audit.html").read_text()


def test_the_verb_writes_report_numbers_and_bundle(tmp_path, command):
    trimesh.creation.torus(1.0, 0.38).export(tmp_path / "ring.stl")
    line = f"audit {tmp_path}/ring.stl --out {tmp_path}/out --quiet --densities 300 --working 600"
    printed = command(line).out
    assert "genus 1" in printed and "--condition C2" in printed
    assert re.search(r"Measurable at M = 600: \d of 2 loops, \d of 1 void; the loss acts on loops", printed)
    assert load_bundle(tmp_path / "out" / "bundle.json").samples == 600
    stored = json.loads((tmp_path / "out" / "audit.json").read_text())
    assert [each["samples"] for each in stored["staircase"]] == [300, 600] and len(stored["commands"]) == 3


def test_a_soup_or_a_scene_is_asked_for_its_betti_numbers(tiny_scene, tmp_path, command):
    printed = command(f"audit --scene {tiny_scene.path}").out
    assert "--betti 1,0,1; correct what you know better" in printed and "next 0." in printed
    assert "give a mesh" in command("audit", code=2).err
    command(f"audit --scene {tiny_scene.path} --densities 64 --out a", code=2)
    assert "a mesh is audited whole" in command(f"audit torus --scene {tmp_path}", code=2).err
    save_soup(tmp_path / "soup.npz", initial_soup(tiny_scene.points, 400, 0))
    assert "M = 16384: " in command(f"audit {tmp_path}/soup.npz").out
    assert "M = 16384: " in command(f"audit {tmp_path}/soup.npz --scene {tiny_scene.path}").out


def test_a_failing_certificate_is_audited_by_what_is_seen():
    (vertices, faces), *_ = shapes.KNOWN["pinched vertex"]
    audit = audit_mesh(checked_mesh(vertices, faces, "pinched"), **SMALL)
    assert not audit.certificate.passed and audit.decision.basis == "observation"
    assert "certificate fails" in " ".join(audit.decision.reasons)
    assert isinstance(headline(audit), str) and "The certificate fails, so the first two" in audit_page(audit)
    assert audit.commands[:2] == (
        "python -m paper_artifact ingest pinched --out pinched_shell.ply",
        "python -m paper_artifact audit pinched_shell.ply",
    )


def test_marks_lie_on_what_they_mark():
    """A torus (radii 1, .4): its loops close around tube or hole, its void's largest ball fills the tube."""
    torus = find_mesh("torus")
    points, _, _ = sample_surface(torus.vertices, torus.faces, 1500, stream(0, "marks"))
    spacing = measurement_floor(points, 1.0) / 6
    marks = find_marks(points, 6 * spacing, (0, 2, 1))
    assert [mark.dimension for mark in marks] == [1, 1, 2] and marks[0].margin > 1
    turns = set()
    for mark in marks[:2]:
        line = mark.line
        assert (line[0] == line[-1]).all() and len(line) > 8
        assert np.linalg.norm(np.diff(line, axis=0), axis=1).max() < 10 * spacing
        around = np.unwrap(np.arctan2(line[:, 1], line[:, 0]))
        tube = np.unwrap(np.arctan2(line[:, 2], np.hypot(line[:, 0], line[:, 1]) - 1.0))
        turns.add(tuple(int(round(abs(angle[-1] - angle[0]) / (2 * np.pi))) for angle in (around, tube)))
    assert turns == {(1, 0), (0, 1)} or turns == {(1, 0), (1, 1)}, turns
    void = marks[2]
    assert len(void.line) == 0 and np.hypot(*void.centre[:2]) == pytest.approx(1.0, abs=0.1)
    tree_distance = np.linalg.norm(points - void.centre, axis=1).min()
    assert tree_distance == pytest.approx(void.radius, rel=1e-6)
    on, through = view_parts(torus, marks, SAME).values()
    assert len(torus.faces) < len(on) < len(through)
    pair = find_marks(np.concatenate([points, points + (9.0, 0, 0)]), 6 * spacing, (1, 4, 2))
    assert pair[0].dimension == 0 and np.ptp(pair[0].line[:, 0]) > 5


def test_a_mesh_made_light_for_the_page_stays_closed_and_a_thin_wall_does_not_touch_itself():
    outer, inner = trimesh.creation.icosphere(5), trimesh.creation.icosphere(5, radius=0.995)
    both = shapes.joined((outer.vertices, outer.faces), (inner.vertices, inner.faces[:, ::-1]))
    shell = checked_mesh(*both, "shell")
    light = light_mesh(shell, most=6000)
    assert 1000 < len(light.faces) <= 6000 and light.diagonal == pytest.approx(shell.diagonal, rel=0.05)
    assert light_mesh(shell, most=len(shell.faces)).faces is shell.faces
    edges = np.sort(light.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] % 2 == 0).all()
    assert len(trimesh.Trimesh(light.vertices, light.faces, process=False).split(only_watertight=False)) == 2
