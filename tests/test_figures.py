"""The style of the figures: colours that differ in every kind of colour vision, letters that can be read in
print."""

from itertools import combinations

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.text import Text
from skimage.color import deltaE_ciede2000, rgb2lab

from paper_artifact.catalogue import CONDITIONS, colour_of, marker_of
from paper_artifact.plot import DIMENSIONS, SERIES, TEXT, new_figure

# Machado, Oliveira, Fernandes 2009, severity 1, on linear RGB.
VISION = {
    "usual": np.eye(3),
    "protanopia": [
        [0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998],
    ],
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881],
    ],
    "tritanopia": [
        [1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900],
    ],
}  # fmt: skip
APART = 12.0  # CIEDE2000; 2 is just noticeable side by side
ARMS = [each.name for each in CONDITIONS]
STUDIES = {  # arms that stand in one figure
    "table1": [name for name in ARMS if name.startswith("C")],
    "allocation": ["C0", *(name for name in ARMS if name.startswith("B"))],
    "words": ["C0", "C1", "C2", *(name for name in ARMS if name.startswith("T"))],
}


def seen(colours, vision):
    """Return CIELAB of colours as that kind of vision has them."""
    rgb = np.array([to_rgb(each) for each in colours])
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    linear = np.clip(linear @ np.transpose(VISION[vision]), 0, 1)
    return rgb2lab(np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055))


@pytest.mark.parametrize("vision", VISION)
@pytest.mark.parametrize("study", STUDIES)
def test_conditions_of_one_figure_differ_in_every_kind_of_colour_vision(study, vision):
    arms = STUDIES[study]
    lab = seen([colour_of(arm) for arm in arms], vision)
    for a, b in combinations(range(len(arms)), 2):
        assert deltaE_ciede2000(lab[a], lab[b]) > APART, (arms[a], arms[b])
    assert len({marker_of(arm) for arm in arms}) == len(arms), "a second way to tell them apart"
    assert lab[:, 0].max() < 82, "seen on white paper"


@pytest.mark.parametrize("vision", ("usual", "protanopia", "deuteranopia"))
def test_dimensions_and_series_differ_too(vision):
    for colours in ([colour for colour, _ in DIMENSIONS.values()], SERIES[:4]):
        lab = seen(colours, vision)
        for a, b in combinations(range(len(colours)), 2):
            assert deltaE_ciede2000(lab[a], lab[b]) > APART, (colours[a], colours[b])


def test_the_style_holds_in_axes_made_later():
    axis = new_figure(1, 1, 2, 2)[1][0][0]
    axis.set(title="title", xlabel="x", xscale="log")
    sizes = {each.get_fontsize() for each in axis.findobj(Text)}
    assert sizes == {TEXT}
