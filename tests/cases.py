"""Small inputs of other people, a folder for each case: what becomes of each, as one table.

`python -m tests.cases FOLDER` reads every mesh, COLMAP scene, transforms.json and folder of photographs in
FOLDER as the command line does, and runs every script; the words that are due stand in `DUE`. A row without
them, or an input that `DUE` does not know, ends it with exit code 1. Two cases have no input: a checkout with
Windows' line ends, and the photographs that `make.py` cuts out (a minute, with pycolmap).
"""

from __future__ import annotations

import io
import shutil
import subprocess
import sys
import tempfile
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path

import numpy as np

from paper_artifact.certify.certificate import certify_mesh
from paper_artifact.errors import InputError
from paper_artifact.files import REPOSITORY
from paper_artifact.mesh import load_mesh
from paper_artifact.photos.scene import PhotosConfig, photographs_scene
from paper_artifact.scene.folder import scene_root
from paper_artifact.scene.load import load_scene
from paper_artifact.scene.transforms import TransformsConfig, transforms_scene

BALL, VIEWS = "8 views, 500 points, 1.0 from the origin", "8 views, 500 points"
CUBE, CUBES = "12 triangles, Betti (1, 0, 1), area 6.0", "Betti (3, 0, 3), area 18.0"
LENS, DRACO = (
    "which is not read; turn the images",
    "compressed with Draco (KHR_draco_mesh_compression), which",
)
SMALL, SHOWN = TransformsConfig(points=500), 250
FIRST = "this loss has a first derivative only"
DUE = {
    "alpha_double_backward/t2.py": f"grad InputError {FIRST}",
    "alpha_peer/bottleneck_shapes.py": "InputError",
    "alpha_peer/certify_pillow.py": "twice",
    "alpha_peer/int_tensor.py": "[0.0, 1.5]] as float64: [[0.0, 1.5], [0.0, 1.5]",
    "alpha_peer/scales.py": "of 7e-38 beside unit points [4, 2, 1]",  # docs/persistence.md: equal
    "alpha_scale/t.py": "[scale 1e160] ok [59, 116, 41]",
    "alpha_types/t.py": "[int tensor] ok [(59, torch.float64",
    "checkout_crlf": "both scripts run",
    "cli_encodings/crlf_quads.obj": CUBE,
    "colmap_all_white": "8 of 8 photographs are of a single colour",
    "colmap_image_names/case_differs": VIEWS,
    "colmap_image_names/gbk": "refused: no image at",
    "colmap_image_names/missing_images": "1 of 8 views are left out",
    "colmap_image_names/png_instead_of_jpg": VIEWS,
    "colmap_images_txt_one_line": VIEWS,
    **{f"colmap_layouts/{name}": VIEWS for name in ("colmap_subfolder", "images_4_only", "images_in_input")},
    **{
        f"colmap_layouts/{name}": VIEWS
        for name in ("mixed_bin_txt", "model_in_root", "points_ply", "sparse_1")
    },
    "colmap_layouts/no_points": "refused: no_points has an SfM cloud of 0 points; at least 4 are needed",
    "colmap_zero_distortion/opencv_zero": VIEWS,
    "colmap_zero_distortion/radial_zero": VIEWS,
    "gltf_compressed_messages/draco.glb": DRACO,
    "gltf_compressed_messages/meshopt.glb": "compressed with meshopt (EXT_meshopt_compression)",
    "gltf_features_ignored/draco_beside_plain.glb": DRACO,
    **{f"gltf_features_ignored/{name}.glb": CUBE for name in ("fan_and_triangles", "fans", "sparse")},
    "gltf_features_ignored/gpu_instancing.glb": CUBES,
    "gltf_features_ignored/quantized_beside_float.glb": "Betti (2, 0, 2), area 12.0",
    "gltf_features_ignored/quantized_normalized.glb": CUBE,
    "images_wrong_kind": "refused: 4 of 4 files are no photographs",
    "obj_bom_shifts_indices/bom.obj": CUBE,
    "obj_bom_shifts_indices/bom_shifted.obj": CUBE,
    "obj_negative_interleaved/interleaved_negative.obj": CUBES,
    "photos_cutout_png": "8 masks",
    **{
        f"ply_variants/{name}.ply": CUBE
        for name in ("blank_ascii", "mixed_binary", "nan_unused", "tristrips")
    },
    "stl_rounded_apart/rounded_apart.stl": "of another, as rounding leaves them",
    "transforms_angle_y": BALL,
    **{
        f"transforms_lens_models/{name}": LENS for name in ("equirectangular", "fisheye_zero_k", "is_fisheye")
    },
    "transforms_masks_and_cloud/mask_path": BALL,
    "transforms_masks_and_cloud/ply_cloud": "8 views, 200 points",
    **{
        f"transforms_paths/{name}": VIEWS for name in ("JPEG_upper_no_ext", "PNG_upper", "absolute_elsewhere")
    },
    **{f"transforms_paths/{name}": VIEWS for name in ("backslash", "parent_dir/x/nerf", "url_escaped")},
    "transforms_paths/one_missing": "1 of 8 frames are left out",
    "transforms_paths/wrong_case_ext": VIEWS,
    "transforms_per_frame_distortion": "500 points, 1.1 from the origin",  # taken out of straight images,
    "transforms_per_frame_intrinsics": BALL,
    "transforms_per_frame_only": BALL,
}
MOVED = {  # what the scripts import, and where it is now
    "from paper_artifact.evaluate.bottleneck import": "from paper_artifact.alpha import",
    "from paper_artifact.certify.certificate import certify\n": (
        "from paper_artifact.certify.certificate import certify_mesh\nfrom paper_artifact.mesh import Mesh\n"
        "certify = lambda points, faces: certify_mesh(Mesh(points, faces, 'case'))\n"
    ),
    "PROJECT": str(REPOSITORY),
    "scratch/peer/cases/": "",
}


def become(path: Path, work: Path) -> str:
    """Return what becomes of an input; work: a new folder. Raises InputError where it is refused."""
    if path.suffix == ".py" or path.name == "photos_cutout_png":
        script = path if path.suffix else path / "make.py"
        text = script.read_text()
        for old, new in MOVED.items():
            text = text.replace(old, new)
        (work / "case.py").write_text(text)
        for array in script.parent.glob("*.npy"):
            shutil.copy(array, work)
        ran = subprocess.run(
            [sys.executable, "case.py"], cwd=work, capture_output=True, text=True, timeout=600
        )
        if path.suffix:
            return f"ran: {ran.stdout} {ran.stderr[-500:]}"
        found = photographs_scene(
            work / "cutout_png", work / "scene", PhotosConfig(400), progress=False, tell=print
        )
        return f"read: {len(found.names)} photographs, {len(list((found.folder / 'masks').iterdir()))} masks"
    if path.name == "checkout_crlf":
        words = [
            "git",
            "-c",
            "core.autocrlf=true",
            "clone",
            "-q",
            "--depth=1",
            f"file://{REPOSITORY}",
            str(work / "c"),
        ]
        subprocess.run(words, check=True)
        for name in ("reproduce.sh", "test.sh"):
            subprocess.run(["bash", "-n", name], cwd=work / "c", check=True)
        return "read: both scripts run"
    if path.suffix:
        mesh = load_mesh(path)
        certificate = certify_mesh(mesh)
        notes = "; ".join((*certificate.reasons, *certificate.notes))
        area = (
            np.linalg.norm(np.cross(*np.diff(mesh.vertices[mesh.faces], axis=1).swapaxes(0, 1)), axis=1).sum()
            / 2
        )
        return f"read: {len(mesh.faces)} triangles, Betti {certificate.betti}, area {area:.1f}; said: {notes}"
    if (path / "transforms.json").is_file():
        try:
            path = transforms_scene(path / "transforms.json", work / "s", SMALL, progress=False)
        except InputError as error:
            if "take --cloud random" not in str(error):
                raise
            print(error)
            path = transforms_scene(
                path / "transforms.json", work / "s", replace(SMALL, cloud="random"), progress=False
            )
    elif not list(path.rglob("cameras.*")):
        photographs_scene(path, work / "s", PhotosConfig(), progress=False, tell=print)
    scene = load_scene(scene_root(path))
    away = np.median(np.linalg.norm(scene.points, axis=1))
    return f"read: {len(scene.names)} views, {len(scene.points)} points, {away:.1f} from the origin"


def main(cases: Path) -> int:
    """Print the table of all cases, and return the number of rows that are not as they should be."""
    wrong = [
        f"{each.name}: no row"
        for each in cases.iterdir()
        if not any(row.startswith(each.name) for row in DUE)
    ]
    print("| case | what becomes of it |\n|---|---|")
    for name, due in DUE.items():
        with (
            tempfile.TemporaryDirectory() as work,
            redirect_stdout(io.StringIO()) as told,
            redirect_stderr(told),
        ):
            try:
                text = become(cases / name, Path(work))
            except InputError as error:
                text = f"refused: {error}"
            except Exception as error:
                text = f"fails: {error!r}"
        said = " ".join(f"{text}; said: {told.getvalue()}".split())
        said = said.replace(f"{cases / name}", name.rpartition("/")[2])
        if due not in said:
            wrong.append(f"{name}: {due!r} is due")
        begin = max(0, said.find(due) - 80) if text.startswith("ran") else 0
        print(f"| {name} | {said[begin:][:SHOWN]} |", flush=True)
    print(*wrong, sep="\n")
    return len(wrong)


if __name__ == "__main__":
    sys.exit(min(1, main(Path(sys.argv[1]))))
