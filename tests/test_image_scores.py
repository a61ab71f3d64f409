"""PSNR and SSIM against a direct loop over windows."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from paper_artifact.errors import InputError
from paper_artifact.evaluate.image import image_scores, psnr, ssim
from paper_artifact.randomness import stream


def naive_ssim(x: np.ndarray, y: np.ndarray) -> float:
    """Wang et al. 2004, window by window, with an 11×11 Gaussian of σ 1.5, windows inside the image only."""
    weights = np.array(
        [[math.exp(-((i - 5) ** 2 + (j - 5) ** 2) / (2 * 1.5**2)) for j in range(11)] for i in range(11)]
    )
    weights /= weights.sum()
    values = []
    for channel in range(x.shape[2]):
        for row in range(x.shape[0] - 10):
            for column in range(x.shape[1] - 10):
                p = x[row : row + 11, column : column + 11, channel]
                q = y[row : row + 11, column : column + 11, channel]
                mean_p, mean_q = (weights * p).sum(), (weights * q).sum()
                var_p, var_q = (weights * (p - mean_p) ** 2).sum(), (weights * (q - mean_q) ** 2).sum()
                cov = (weights * (p - mean_p) * (q - mean_q)).sum()
                values.append(
                    (2 * mean_p * mean_q + 1e-4)
                    * (2 * cov + 9e-4)
                    / ((mean_p**2 + mean_q**2 + 1e-4) * (var_p + var_q + 9e-4))
                )
    return sum(values) / len(values)


def test_ssim_equals_the_window_loop():
    generator = stream(0, "test")
    x = generator.random((19, 23, 3))
    y = np.clip(x + 0.2 * generator.normal(size=x.shape), 0, 1)
    assert ssim(x, y) == pytest.approx(naive_ssim(x, y), abs=1e-12)
    assert ssim(x, x) == pytest.approx(1)
    assert ssim(x[:11, :11], 1 - x[:11, :11]) == pytest.approx(
        naive_ssim(x[:11, :11], 1 - x[:11, :11]), abs=1e-12
    )


def test_psnr_closed_form_and_means_over_views():
    image = np.full((12, 12, 3), 0.25)
    assert psnr(image, image + 0.1) == pytest.approx(20.0)
    assert psnr(image, image) == pytest.approx(100.0)
    stack, other = (stream(seed, "test").random((2, 12, 13, 3)).astype(np.float32) for seed in (1, 2))
    scores = image_scores(stack, other)
    assert scores["psnr"] == pytest.approx((psnr(stack[0], other[0]) + psnr(stack[1], other[1])) / 2)
    assert scores["views"][1][1] == pytest.approx(ssim(stack[1], other[1]))


def test_refuses_images_that_do_not_match():
    image = np.zeros((12, 12, 3))
    with pytest.raises(InputError, match="one shape"):
        psnr(image, image[:-1])
    with pytest.raises(InputError, match="11 pixels"):
        ssim(image[:10], image[:10])
    with pytest.raises(InputError, match="n > 0"):
        image_scores(np.zeros((0, 12, 12, 3)), np.zeros((0, 12, 12, 3)))
    for wrong in (image * 1j, np.full((12, 12, 3), "a")):
        with pytest.raises(InputError, match="the images are not numbers"):
            psnr(wrong, image)
    assert psnr(torch.zeros(12, 12, 3, dtype=torch.bfloat16, requires_grad=True), image) == pytest.approx(100)
