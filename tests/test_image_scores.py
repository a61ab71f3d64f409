"""PSNR and SSIM against a direct loop over windows."""

import numpy as np
import pytest
import torch

from paper_artifact.errors import InputError
from paper_artifact.evaluate.image import image_scores, psnr, ssim
from paper_artifact.randomness import stream


def naive_ssim(x: np.ndarray, y: np.ndarray) -> float:
    """Wang et al. 2004, window by window, with an 11×11 Gaussian of σ 1.5, windows inside the image only."""
    bell = np.exp(-((np.arange(11) - 5) ** 2) / (2 * 1.5**2))
    weights = np.outer(bell, bell) / bell.sum() ** 2
    p, q = (np.lib.stride_tricks.sliding_window_view(each, (11, 11), axis=(0, 1)) for each in (x, y))

    def mean(windows):
        return (weights * windows).sum(axis=(-2, -1))

    mean_p, mean_q = mean(p), mean(q)
    off_p, off_q = p - mean_p[..., None, None], q - mean_q[..., None, None]
    similarity = (2 * mean_p * mean_q + 1e-4) * (2 * mean(off_p * off_q) + 9e-4)
    similarity /= (mean_p**2 + mean_q**2 + 1e-4) * (mean(off_p**2) + mean(off_q**2) + 9e-4)
    return float(similarity.mean())


def test_ssim_equals_the_window_loop():
    generator = stream(0, "test")
    x = generator.random((19, 23, 3))
    y = np.clip(x + 0.2 * generator.normal(size=x.shape), 0, 1)
    assert ssim(x, y) == pytest.approx(naive_ssim(x, y), abs=1e-12)
    assert ssim(x, x) == pytest.approx(1)
    one = x[:11, :11]
    assert ssim(one, 1 - one) == pytest.approx(naive_ssim(one, 1 - one), abs=1e-12)


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
