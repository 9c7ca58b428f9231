"""The C++ that kernels/lanes.py writes from Warp functions: small cases, to the bit as the functions themselves."""

import subprocess
import sys
from typing import Any

import numpy as np
import pytest
import warp as wp

from warpsar.kernels import lanes
from warpsar.kernels.codes import Spectrum
from warpsar.kernels.geometry import (
    cos2_azimuth_of,
    cos_incidence_of,
    cos_twist_of,
    intersect,
    normal_of,
    point_on,
)

LANES = 8
BELOW = wp.constant(-1.5)


@wp.struct
class Pair:
    product: float
    side: wp.vec3


@wp.func
def square(x: Any):
    return x * x


@wp.func
def blended(code: int, x: float, y: float, z: float) -> float:
    """An `if` that differs between lanes, within another, and a number that all lanes begin with."""
    value = type(x)(0.0)
    if x > 0.5:
        value = wp.exp(-x) + y
        if y > 0.0:
            value += wp.sqrt(y) / (x + z * z)
    elif x > BELOW and not y > 1.0:
        twice = x + x
        value = twice * y
    else:
        value = 1.0
    return value


@wp.func
def uniform(code: int, x: float, y: float, z: float) -> float:
    """An `if` on what is the same in all lanes, and one on what is not inside of it."""
    value = x
    if code == Spectrum.EXPONENTIAL:
        value = y / z
        if value > 1.0 or x < 0.0:
            value = 1.0 - value
    elif code != Spectrum.GAUSSIAN and wp.abs(float(code)) > 1.0:
        value = wp.where(x > y, x, -z)
    return value


@wp.func
def vectors(code: int, x: float, y: float, z: float) -> float:
    """Vectors and structs, a variable that is called as a function is, and what is the same in all lanes in between."""
    up = wp.vec3(0.0, 0.0, 1.0)
    place = wp.vec3(x, y, z)
    pair = Pair()
    pair.side = wp.normalize(wp.cross(place, up))
    length = wp.length(place - 2.0 * up)
    pair.product = wp.dot(-place / length, pair.side + up)
    if pair.product < 0.0:
        pair.product = place[1] * (x - (y - z)) / (x / y)
    return pair.product + wp.dot(up, pair.side * length)


@wp.func
def complex_and_square(a: Any, b: Any):
    return wp.vector(a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]), square(a[0])


@wp.func
def several(code: int, x: float, y: float, z: float) -> float:
    """A function with several results, and numbers in the type of others."""
    product, size = complex_and_square(wp.vector(x, y), wp.vector(type(y)(2.0), z))
    again, _size = complex_and_square(product, product)
    half, quarter = complex_and_square(wp.vector(0.5, 0.0), wp.vector(1.0, 0.0))
    return again[0] * type(x)(wp.pi) + again[1] * size * half[0] - quarter


@wp.func
def leaving(code: int, x: float, y: float, z: float) -> float:
    """Lanes that return before others do."""
    if x < -1.0:
        return y
    if y > x:
        half = 0.5 * z
        return wp.exp(half) * y
    return x - y


@wp.func
def summed(code: int, x: float, y: float, z: float) -> float:
    """A series, some terms of which some lanes leave out; a variable is of lanes only from its second turn on."""
    total = type(x)(1.0)
    last = type(x)(2.0)
    for n in range(1, code + 4):
        if last > 0.3 * y:
            total += last / float(n)
        last = last * x * 0.5
    return total


@wp.func
def words(code: int, x: float, y: float, z: float) -> float:
    low = wp.min(wp.floor(x), wp.clamp(y, -1.0, 0.5))
    turned = wp.sin(x) * wp.cos(y) + wp.atan2(x, y)
    return low + wp.max(turned, wp.sqrt(wp.abs(z))) * float(int(wp.floor(y)))


@wp.func
def geometry(code: int, x: float, y: float, z: float) -> float:
    a = wp.vec3(x, -1.0, 0.2)
    b = wp.vec3(1.0, y, z)
    c = wp.vec3(-1.0, 0.7, x * y)
    direction = wp.normalize(wp.vec3(0.1, z, -1.0))
    hit = intersect(wp.vec3(0.0, x, 9.0), direction, a, b, c)
    normal = normal_of(a, b, c)
    value = cos_incidence_of(normal, direction) + cos_twist_of(normal, direction, wp.vec3(1.0, 0.0, 0.0))
    return value + cos2_azimuth_of(normal, direction) + hit.distance * point_on(a, b, c, hit.b1, hit.b2)[1]


CASES = (blended, uniform, vectors, several, leaving, summed, words, geometry)
# The exponential is the lanes' own, within 2e-7: other sums of it may lose one digit more.
OWN_EXPONENTIAL = ("blended", "leaving")


def written(function: Any) -> str:
    return lanes.source(LANES, {function: ("code",)})


def kernels_of(function: Any) -> tuple[Any, Any]:
    """A kernel that takes one element after the other, and one that takes LANES of them at once."""

    @wp.kernel(enable_backward=False, module="unique")
    def one_by_one(code: int, values: wp.array2d(dtype=float), out: wp.array(dtype=float)):
        i = wp.tid()
        out[i] = function(code, values[0, i], values[1, i], values[2, i])

    load = "".join(
        f"Lanes::V {name}; __builtin_memcpy(&{name}, &values.data[{row} * values.shape[1] + 8 * block], 32);"
        for row, name in enumerate("xyz")
    )
    call = f"const Lanes::V found = Lanes::{function.key}(code, x, y, z);"
    store = "__builtin_memcpy(&out.data[8 * block], &found, 32);"

    @wp.func_native(written(function) + load + call + store)
    def block_of(block: int, code: int, values: wp.array2d(dtype=float), out: wp.array(dtype=float)): ...

    @wp.kernel(enable_backward=False, module="unique")
    def at_once(code: int, values: wp.array2d(dtype=float), out: wp.array(dtype=float)):
        block_of(wp.tid(), code, values, out)

    return one_by_one, at_once


@pytest.mark.parametrize("function", CASES, ids=lambda f: f.key)
def test_as_the_function_itself(function: Any) -> None:
    """Blocks with lanes of all branches, of one alone, and with the ends of every range."""
    random = np.random.default_rng(0)
    values = random.normal(0.0, 1.5, (3, 64 * LANES)).astype(np.float32)
    values[:, : 8 * LANES] = np.abs(values[:, : 8 * LANES])
    values[:, 8 * LANES : 16 * LANES] *= -1
    kernels = kernels_of(function)
    for code in range(3):
        expected, found = (wp.zeros(64 * LANES, dtype=float, device="cpu") for _ in range(2))
        given: Any = [code, wp.array(values, dtype=float, device="cpu")]
        wp.launch(kernels[0], 64 * LANES, inputs=given, outputs=[expected], device="cpu")
        wp.launch(kernels[1], 64, inputs=given, outputs=[found], device="cpu")
        assert np.isfinite(expected.numpy()).all()
        assert len(np.unique(expected.numpy())) > 60
        if function.key in OWN_EXPONENTIAL:
            np.testing.assert_allclose(found.numpy(), expected.numpy(), rtol=2e-6, atol=2e-6)
        else:
            np.testing.assert_array_equal(found.numpy(), expected.numpy())


def test_a_branch_on_a_uniform_number_stays_one() -> None:
    text = written(uniform)
    assert "if (code == 1 /* EXPONENTIAL */) {" in text
    assert text.count("choose(when") == 1  # and the choice inside of it is one lane by lane


def test_every_function_is_written_once_for_each_kind_of_its_arguments() -> None:
    text = written(several)
    assert text.count(" square(V x)") == 1
    assert text.count("complex_and_square_results complex_and_square(") == 1
    assert text.count("complex_and_square_results1 complex_and_square(") == 1  # of what is the same in all lanes


@wp.func
def one_step(x: float) -> float:
    while x > 1.0:
        x = x - 1.0
    return x


@wp.func
def in_double(x: float) -> float:
    return float(wp.float64(x) + wp.float64(1.0))


@wp.func
def by_twos(x: float) -> float:
    for _ in range(0, 4, 2):
        x = x * x
    return x


@wp.func
def of_own_length(x: float) -> float:
    return wp.vec3(x)[0]


@pytest.mark.parametrize(
    ("function", "what"),
    [(one_step, "while x > 1.0"), (in_double, "wp.float64"), (by_twos, "2"), (of_own_length, "wp.vec3(x)")],
)
def test_what_it_does_not_know_is_said_with_its_line(function: Any, what: str) -> None:
    with pytest.raises(NotImplementedError, match=r"test_lanes\.py:\d+: ") as raised:
        lanes.source(LANES, {function: ()})
    assert what in str(raised.value)
    line = int(str(raised.value).split(".py:")[1].split(":")[0])
    first = function.func.__code__.co_firstlineno
    assert first < line <= first + 3


def test_the_text_is_the_same_in_every_process() -> None:
    """Warp's cache goes by the text."""
    script = (
        "import hashlib\n"
        "from warpsar.kernels import hit_lanes, raster_lanes, record_lanes\n"
        "from warpsar.kernels.lane_kernels import at_once\n"
        "from warpsar.kernels.scatter import scatter_kernel\n"
        "text = at_once(scatter_kernel('i2em', True)).key + record_lanes._GEOMETRY + hit_lanes._GEOMETRY\n"
        "text += raster_lanes._START\n"
        "print(hashlib.sha256(text.encode()).hexdigest())"
    )
    found = set()
    for seed in ("1", "2"):
        done = subprocess.run(
            [sys.executable, "-c", script], env={"PYTHONHASHSEED": seed}, capture_output=True, text=True, check=True
        )
        found.add(done.stdout.strip())
    assert len(found) == 1
    assert len(found.pop()) == 64
