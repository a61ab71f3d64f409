"""`reconstruct`: photographs or a video → scene, soup, pictures and mesh in one command, and again."""

import shlex
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageFilter

from paper_artifact.cli import main
from paper_artifact.errors import InputError
from paper_artifact.photos.pictures import video_frames
from tests.test_photographs import MUG, mug

av = pytest.importorskip("av", reason="PyAV has no wheel here")
EVERY = 3


@pytest.fixture(scope="module")
def video(tmp_path_factory) -> Path:
    """Eight photographs of the mug, each between two blurred copies, as H.264."""
    file = tmp_path_factory.mktemp("video") / "walk.mp4"
    with av.open(file, "w") as container:
        stream = container.add_stream("libx264", rate=Fraction(25), options={"crf": "14"})
        stream.width, stream.height, stream.pix_fmt = 600, 450, "yuv420p"
        for index in range(30, 38):
            sharp = mug(index).resize((600, 450))
            blurred = sharp.filter(ImageFilter.GaussianBlur(4))
            for picture in (blurred, sharp, blurred):
                container.mux(stream.encode(av.VideoFrame.from_image(picture)))
        container.mux(stream.encode())
    return file


def test_of_every_few_frames_the_sharpest_is_taken(video, tmp_path):
    assert video_frames(video, EVERY, tmp_path / "frames", False) == EVERY
    frames = sorted((tmp_path / "frames").iterdir())
    assert len(frames) == 8
    for file, index in zip(frames, range(30, 38), strict=True):
        with Image.open(file) as taken:
            off = np.asarray(taken, float) - np.asarray(mug(index).resize((600, 450)), float)
        assert np.sqrt((off**2).mean()) < 6, f"{file.name} is blurred"
    assert video_frames(video, None, tmp_path / "all", False) == 1
    with pytest.raises(InputError, match="24 frames; give a smaller --every"):
        video_frames(video, 20, tmp_path / "few", False)


@pytest.mark.parametrize("sound", (False, True))
def test_a_short_video_is_whole(sound, tmp_path):
    """Eleven frames, of which the last begins at ten elevenths; the sound goes on after the picture."""
    with av.open(tmp_path / "a.mkv", "w") as container:
        streams = [container.add_stream("mpeg4", rate=10, width=64, height=48, pix_fmt="yuv420p")]
        noise = np.random.default_rng(0).integers(0, 255, (11, 48, 64, 3), dtype=np.uint8)
        frames = [[av.VideoFrame.from_ndarray(each, "rgb24") for each in noise]]
        if sound:
            streams.append(container.add_stream("pcm_s16le", rate=8000))
            silence = av.AudioFrame.from_ndarray(np.zeros((1, 16000), np.int16), layout="mono")
            silence.sample_rate = 8000
            frames.append([silence])
        for stream, own in zip(streams, frames, strict=True):
            container.mux([packet for each in [*own, None] for packet in stream.encode(each)])
    assert video_frames(tmp_path / "a.mkv", 1, tmp_path / "frames", False) == 1
    assert len([*(tmp_path / "frames").iterdir()]) == 11


def test_what_is_no_video_is_refused(video, tmp_path, capsys):
    (tmp_path / "text.mp4").write_text("no video")
    (tmp_path / "cut.mp4").write_bytes(video.read_bytes()[:2000])

    def refused(place, *words):
        assert main(["photos", str(place), f"--out={tmp_path / 'scene'}", "--quiet", *words]) == 1
        assert not (tmp_path / "scene").exists()
        return capsys.readouterr().err

    for name in ("text.mp4", "cut.mp4"):
        assert "convert it to MP4" in refused(tmp_path / name)
    for short in (tmp_path / "short.mp4", tmp_path / "short.mkv"):  # the second declares no frames
        with av.open(short, "w", options={"movflags": "faststart"}) as out, av.open(video) as whole:
            copied = out.add_stream_from_template(whole.streams.video[0])
            for packet in whole.demux(whole.streams.video[0]):
                if packet.dts is not None:
                    packet.stream = copied
                    out.mux(packet)
        video_frames(short, EVERY, tmp_path / short.suffix, False)
        short.write_bytes(short.read_bytes()[: short.stat().st_size * 2 // 3])
        assert "is cut off: it says 24 frames" in refused(short)
    assert "--every belongs to a video" in refused(MUG / "photographs", "--every=2")


def test_results_do_not_lie_among_the_photographs(tmp_path, capsys):
    for work in (tmp_path, tmp_path / "work"):
        assert main(["reconstruct", str(tmp_path), "--work", str(work)]) == 1
        assert "lies among the photographs" in capsys.readouterr().err
        assert not list(tmp_path.iterdir())


def test_one_command_from_a_video_to_a_mesh(video, tmp_path, capsys):
    pytest.importorskip("pycolmap", reason="no wheel here")
    words = ["reconstruct", str(video), f"--every={EVERY}", "--budget=300", "--steps=30", "--quiet"]
    words += [f"--work={tmp_path / 'work'}"]
    assert main(words) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == ["photographs", "training", "pictures", "next:"]
    assert "8 photographs registered" in lines[0] and "held-out PSNR" in lines[1]
    assert len(list((tmp_path / "work").glob("*.views.png"))) == 1
    assert shlex.split(lines[-1])[4:] == [
        *("reconstruct", str(video), "--every", str(EVERY), "--budget", "300", "--steps", "30", "--work"),
        *(str(tmp_path / "work"), "--betti", "1,1,0", "--out", "mesh.ply"),
    ]
    code = main([*words, f"--out={tmp_path / 'mesh.ply'}", "--betti=1,2,1"])
    lines = capsys.readouterr().out.splitlines()
    assert ", as before: " in lines[0] and "as recorded" in lines[1]
    assert code == (0 if (tmp_path / "mesh.ply").exists() else 1)


@pytest.mark.parametrize(
    ("words", "answer"),
    [
        (["--out=a.obj"], "must end in .ply or .glb"),
        (["--out=a.ply", "--betti=1,2,2"], "no solid has the Betti numbers"),
        (["--betti=1,2,1"], "--betti belongs to --out"),
    ],
)
def test_wrong_usage_is_said_first(words, answer, tmp_path, capsys):
    assert main(["reconstruct", str(tmp_path / "nowhere"), *words]) == 2
    assert answer in capsys.readouterr().err
