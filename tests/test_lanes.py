"""The vector type against numpy, at lengths that are and are not multiples of its width."""

import numba
import numpy as np
import pytest

from paper_artifact.randomness import stream
from paper_artifact.raster import lanes
from paper_artifact.raster.lanes import WIDTH

LENGTHS = (1, 15, 16, 17, 67)


def floats(seed: int, count: int) -> np.ndarray:
    return stream(seed, "lanes test").normal(size=count).astype(np.float32)


def integers(seed: int, count: int) -> np.ndarray:
    return stream(seed, "lanes test").integers(-(2**31), 2**31, count).astype(np.int32)


@numba.njit
def arithmetic(x, y, out):
    for i in range(0, len(x), WIDTH):
        count = len(x) - i
        a, b = lanes.load_part(x, i, count), lanes.load_part(y, i, count)
        value = (a + b) * (a - 0.5) / (1.0 + lanes.absolute(b)) - -b
        value += 2.0
        value -= b
        value *= a
        lanes.store_part(out, i, value + lanes.square_root(lanes.absolute(a)) + lanes.floor(b), count)


@pytest.mark.parametrize("count", LENGTHS)
def test_arithmetic_has_numpys_bits_and_writes_no_further(count):
    x, y = floats(0, count), floats(1, count)
    out = np.full(count + WIDTH, np.float32(7.0))
    arithmetic(x, y, out)
    one, half, two = np.float32(1.0), np.float32(0.5), np.float32(2.0)
    value = ((x + y) * (x - half) / (one + np.abs(y)) - -y + two - y) * x
    assert np.array_equal(out[:count], value + np.sqrt(np.abs(x)) + np.floor(y))
    assert (out[count:] == 7.0).all()


def test_a_part_reads_no_further():
    x = np.array([1.0, np.nan, np.nan], np.float32)

    @numba.njit
    def read(x, count):
        return lanes.total(lanes.load_part(x, 0, count))

    assert [read(x, count) for count in (-3, 0, 1)] == [0.0, 0.0, 1.0]
    assert np.isnan(read(x, 2))


def test_lanes_move_where_they_should():
    @numba.njit
    def run(x, out, mask_of):
        a, b = lanes.load(x, 0), lanes.load(x, 16)
        lanes.store(out, 0, lanes.join(lanes.load8(x, 8), lanes.load8(x, 16)))
        lanes.store(out, 16, b)
        left, count = lanes.bits(a < mask_of), 0
        while left:
            out[32 + count] = x[lanes.lowest(left)]
            left &= left - 1
            count += 1
        return count

    x, out = floats(0, 32), np.zeros(48, np.float32)
    for border in (-9.0, 0.0, 9.0):
        out[:] = 0.0
        kept = x[:16][x[:16] < border]
        assert run(x, out, border) == len(kept)
        assert np.array_equal(out[:16], x[8:24]) and np.array_equal(out[16:32], x[16:])
        assert np.array_equal(out[32:], np.r_[kept, np.zeros(16 - len(kept), np.float32)])


def test_gather_and_scatter_leave_other_places_alone():
    @numba.njit
    def run(x, indices, out, limit):
        i = lanes.load(indices, 0)
        mask = i < limit
        lanes.scatter(out, i, lanes.gather(x, i, mask) + 1.0, mask)

    indices = stream(0, "lanes test").permutation(40)[:16].astype(np.int32)
    x, out = floats(0, 20), np.zeros(40, np.float32)
    run(x, indices, out, 20)  # an index from 20 on would read outside x
    expected = np.zeros(40, np.float32)
    expected[indices[indices < 20]] = x[indices[indices < 20]] + np.float32(1.0)
    assert np.array_equal(out, expected)


@pytest.mark.parametrize("count", LENGTHS)
def test_bytes_are_read_as_fractions_of_255(count):
    @numba.njit
    def run(x, out):
        for i in range(0, len(x), WIDTH):
            lanes.store_part(out, i, lanes.load_unit_part(x, i, len(x) - i), len(x) - i)

    x = stream(0, "lanes test").integers(0, 256, count).astype(np.uint8)
    exact = (x / 255).astype(np.float32)
    for source in (x, exact):
        out = np.empty(count, np.float32)
        run(source, out)
        assert np.array_equal(out, exact)


def test_the_compiled_kernel_works_on_vectors():
    run = numba.njit(arithmetic.py_func)
    run(floats(0, 16), floats(1, 16), np.empty(16, np.float32))
    code = run.inspect_llvm(run.signatures[0])
    assert "fadd <16 x float>" in code and "fdiv <16 x float>" in code


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("rows", [1, 5, 40])
def test_rows_are_loaded_as_columns_and_added_one_after_another(rows, kind):
    @numba.njit
    def run(x, indices, out, sums):
        at = lanes.load(indices, 0)
        columns = lanes.load_rows(x, at)
        for k in range(WIDTH):
            lanes.store(out, k * WIDTH, columns[k])
        lanes.add_to_rows(sums, at, columns)

    x = floats(0, rows * WIDTH).reshape(rows, WIDTH)
    indices = stream(1, "lanes test").integers(0, rows, WIDTH).astype(np.int32)
    out, sums = (
        np.zeros((WIDTH, WIDTH), np.float32),
        floats(2, rows * WIDTH).reshape(rows, WIDTH).astype(kind),
    )
    expected = sums.copy()
    for row in indices:
        expected[row] += x[row]
    run(x, indices, out, sums)
    assert np.array_equal(out, x[indices].T) and np.array_equal(sums, expected)
