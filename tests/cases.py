"""Small inputs of other people, a folder for each case: what becomes of each, as one table.

`python -m tests.cases FOLDER` reads every mesh, COLMAP scene, transforms.json and folder of photographs in
FOLDER as the command line does, and runs every script; the words that are due stand in `DUE`. A row without
them, or an input that `DUE` does not know, ends it with exit code 1. Two cases have no input: a checkout with
Windows' line ends, and the photographs that `make.py` cuts out (a minute, with pycolmap).
"""

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
from paper_artifact.sampling import face_areas
from paper_artifact.scene.folder import scene_root
from paper_artifact.scene.load import load_scene
from paper_artifact.scene.transforms import TransformsConfig, transforms_scene

SMALL, SHOWN = TransformsConfig(points=500), 250
CUBE, CUBES = "12 triangles, Betti (1, 0, 1), area 6.0", "Betti (3, 0, 3), area 18.0"
BALL, VIEWS = "8 views, 500 points, 1.0 from the origin", "8 views, 500 points"
DRACO = "compressed with Draco (KHR_draco_mesh_compression), which"
# Words that are due: the cases.
CASES = {
    VIEWS: """colmap_image_names/case_differs colmap_image_names/png_instead_of_jpg colmap_images_txt_one_line
        colmap_layouts/colmap_subfolder colmap_layouts/images_4_only colmap_layouts/images_in_input
        colmap_layouts/mixed_bin_txt colmap_layouts/model_in_root colmap_layouts/points_ply
        colmap_layouts/sparse_1 colmap_zero_distortion/opencv_zero colmap_zero_distortion/radial_zero
        transforms_paths/JPEG_upper_no_ext transforms_paths/PNG_upper transforms_paths/absolute_elsewhere
        transforms_paths/backslash transforms_paths/parent_dir/x/nerf transforms_paths/url_escaped
        transforms_paths/wrong_case_ext""",
    BALL: """transforms_angle_y transforms_masks_and_cloud/mask_path transforms_per_frame_intrinsics
        transforms_per_frame_only""",
    CUBE: """cli_encodings/crlf_quads.obj gltf_features_ignored/fan_and_triangles.glb
        gltf_features_ignored/fans.glb gltf_features_ignored/sparse.glb
        gltf_features_ignored/quantized_normalized.glb obj_bom_shifts_indices/bom.obj
        obj_bom_shifts_indices/bom_shifted.obj ply_variants/blank_ascii.ply ply_variants/mixed_binary.ply
        ply_variants/nan_unused.ply ply_variants/tristrips.ply""",
    CUBES: "gltf_features_ignored/gpu_instancing.glb obj_negative_interleaved/interleaved_negative.obj",
    DRACO: "gltf_compressed_messages/draco.glb gltf_features_ignored/draco_beside_plain.glb",
    "which is not read; turn the images": """transforms_lens_models/equirectangular
        transforms_lens_models/fisheye_zero_k transforms_lens_models/is_fisheye""",
    "grad InputError this loss has a first derivative only": "alpha_double_backward/t2.py",
    "InputError": "alpha_peer/bottleneck_shapes.py",
    "twice": "alpha_peer/certify_pillow.py",
    "[0.0, 1.5]] as float64: [[0.0, 1.5], [0.0, 1.5]": "alpha_peer/int_tensor.py",
    "of 7e-38 beside unit points [4, 2, 1]": "alpha_peer/scales.py",  # docs/persistence.md: equal
    "[scale 1e160] ok [59, 116, 41]": "alpha_scale/t.py",
    "[int tensor] ok [(59, torch.float64": "alpha_types/t.py",
    "both scripts run": "checkout_crlf",
    "8 of 8 photographs are of a single colour": "colmap_all_white",
    "refused: no image at": "colmap_image_names/gbk",
    "1 of 8 views are left out": "colmap_image_names/missing_images",
    "refused: no_points has an SfM cloud of 0 points; at least 4 are needed": "colmap_layouts/no_points",
    "compressed with meshopt (EXT_meshopt_compression)": "gltf_compressed_messages/meshopt.glb",
    "Betti (2, 0, 2), area 12.0": "gltf_features_ignored/quantized_beside_float.glb",
    "refused: 4 of 4 files are no photographs": "images_wrong_kind",
    "8 masks": "photos_cutout_png",
    "of another, as rounding leaves them": "stl_rounded_apart/rounded_apart.stl",
    "8 views, 200 points": "transforms_masks_and_cloud/ply_cloud",
    "1 of 8 frames are left out": "transforms_paths/one_missing",
    "500 points, 1.1 from the origin": "transforms_per_frame_distortion",  # taken out of straight images
}
DUE = {case: words for words, cases in CASES.items() for case in cases.split()}
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
        words = [sys.executable, "case.py"]
        ran = subprocess.run(words, cwd=work, capture_output=True, text=True, timeout=600)
        if path.suffix:
            return f"ran: {ran.stdout} {ran.stderr[-500:]}"
        config = PhotosConfig(400)
        found = photographs_scene(work / "cutout_png", work / "scene", config, progress=False, tell=print)
        return f"read: {len(found.names)} photographs, {len(list((found.folder / 'masks').iterdir()))} masks"
    if path.name == "checkout_crlf":
        words = f"-c core.autocrlf=true clone -q --depth=1 file://{REPOSITORY} {work}/c"
        subprocess.run(["git", *words.split()], check=True)
        for name in ("reproduce.sh", "test.sh"):
            subprocess.run(["bash", "-n", name], cwd=work / "c", check=True)
        return "read: both scripts run"
    if path.suffix:
        mesh = load_mesh(path)
        certificate = certify_mesh(mesh)
        notes = "; ".join((*certificate.reasons, *certificate.notes))
        area = face_areas(mesh.vertices, mesh.faces).sum()
        return f"read: {len(mesh.faces)} triangles, Betti {certificate.betti}, area {area:.1f}; said: {notes}"
    if (path / "transforms.json").is_file():
        try:
            path = transforms_scene(path / "transforms.json", work / "s", SMALL, progress=False)
        except InputError as error:
            if "take --cloud random" not in str(error):
                raise
            print(error)
            anywhere = replace(SMALL, cloud="random")
            path = transforms_scene(path / "transforms.json", work / "s", anywhere, progress=False)
    elif not list(path.rglob("cameras.*")):
        photographs_scene(path, work / "s", PhotosConfig(), progress=False, tell=print)
    scene = load_scene(scene_root(path))
    away = np.median(np.linalg.norm(scene.points, axis=1))
    return f"read: {len(scene.names)} views, {len(scene.points)} points, {away:.1f} from the origin"


def main(cases: Path) -> int:
    """Print the table of all cases, and return the number of rows that are not as they should be."""
    known = {row.partition("/")[0] for row in DUE}
    wrong = [f"{each.name}: no row" for each in cases.iterdir() if each.name not in known]
    print("| case | what becomes of it |\n|---|---|")
    for name, due in DUE.items():
        told = io.StringIO()
        with tempfile.TemporaryDirectory() as work, redirect_stdout(told), redirect_stderr(told):
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
