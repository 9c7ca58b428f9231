"""The deposit of scatterers into range bins on the CPU: eight scatterers at once, some pulses of a few hundred of them.

The steps are those of `collection.deposit_kernel`, in vectors of clang's. A chunk of scatterers stays in the nearest
cache for all pulses of a launch, and a pulse's bins for all scatterers of a chunk. Real and imaginary parts lie in
planes of their own, and weights in a table: so a deposit is one multiplication and one addition of a register each.
"""

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpsar.kernels.collection import BETA, MovingScatterers, SensorTrack

TABLE = 512
"""Steps of the table of weights. Between them weights are linear: to 1e-6 of the largest."""
SPARE = 16
"""Bins of a row beyond the period: WIDTH - 1 deposits and the two empty places of a register."""


def weights_table() -> NDArray[np.float32]:
    """Weights of six bins, the first of which lies u - 3 from the deposit, u = 0 to 1, (TABLE + 1, 8)."""
    distance = (np.linspace(0.0, 1.0, TABLE + 1)[:, None] + np.arange(-3.0, 3.0)) / 3.0
    weights = np.exp(float(BETA) * (np.sqrt(np.maximum(1.0 - distance**2, 0.0)) - 1.0))
    return np.pad(weights, ((0, 0), (0, 2))).astype(np.float32)


_DEPOSIT = """
    typedef double D __attribute__((vector_size(64)));
    typedef float F __attribute__((vector_size(32)));
    typedef int I __attribute__((vector_size(32)));
    typedef float Any __attribute__((vector_size(32), aligned(4)));
    constexpr int CHUNK = 512, MOST = 4;
    double point[3][CHUNK] __attribute__((aligned(64))), velocity[3][CHUNK] __attribute__((aligned(64)));
    float amplitude[2 * MOST][CHUNK] __attribute__((aligned(64)));
    const int count = scatterers.point.shape[0], pols = bins_out.shape[1], pulses = pulse.shape[0];
    const bool moving = scatterers.velocity.shape[0] > 0;
    const bool wide = track.beam.wide > 0.0f, high = track.beam.high > 0.0f;
    const int antennas = track.bistatic ? 2 : 1;
    const auto& pattern = track.beam.pattern;
    const int angles = pattern.shape[0], heights = pattern.shape[1];
    const double period = (double)bins;
    for (int begin = 0; begin < count; begin += CHUNK) {
        const int size = wp::min(CHUNK, count - begin), groups = (size + 7) / 8;
        for (int k = 0; k < 8 * groups; ++k) {
            const int i = begin + wp::min(k, size - 1);
            for (int c = 0; c < 3; ++c) {
                point[c][k] = scatterers.point.data[i].c[c];
                if (moving) velocity[c][k] = scatterers.velocity.data[i].c[c];
            }
            for (int p = 0; p < pols; ++p) {
                const auto& a = wp::index(scatterers.amplitude, p, i);
                amplitude[2 * p][k] = k < size ? a.c[0] : 0.0f;
                amplitude[2 * p + 1][k] = k < size ? a.c[1] : 0.0f;
            }
        }
        for (int row = 0; row < pulses; ++row) {
            const float weight = weights.data[row];
            if (weight == 0.0f) continue;
            const int at_pulse = pulse.data[row];
            float* re[MOST];
            float* im[MOST];
            for (int p = 0; p < pols; ++p) {
                re[p] = &wp::index(bins_out, 0, p, row, 0);
                im[p] = &wp::index(bins_out, 1, p, row, 0);
            }
            for (int g = 0; g < groups; ++g) {
                D x[3];
                for (int c = 0; c < 3; ++c) {
                    x[c] = *(const D*)(point[c] + 8 * g);
                    if (moving) x[c] += track.time.data[at_pulse] * *(const D*)(velocity[c] + 8 * g);
                }
                const D square = x[0] * x[0] + x[1] * x[1] + x[2] * x[2];
                D way = square * 0.0;
                F gain = F{} + weight, aside = F{};
                for (int n = 0; n < antennas; ++n) {
                    const auto& place = n ? track.transmitter.data[at_pulse] : track.receiver.data[at_pulse];
                    const double own = n ? track.transmitter_own.data[at_pulse] : track.receiver_own.data[at_pulse];
                    const D along = place.c[0] * x[0] + place.c[1] * x[1] + place.c[2] * x[2];
                    const D change = square - 2.0 * along;
                    const D distance = __builtin_elementwise_sqrt(own * own + change);
                    way += change / (distance + own);
                    if (angles > 0) {
                        const auto& level = track.beam.along.data[at_pulse];
                        const auto& up = track.beam.up.data[at_pulse];
                        for (int k = 0; k < 8; ++k) {
                            double a = 0.0, b = 0.0;
                            for (int c = 0; c < 3; ++c) {
                                const double to = x[c][k] - place.c[c];
                                a += to * level.c[c];
                                b += to * up.c[c];
                            }
                            const float scale = 57.29577951f;
                            const auto& start = track.beam.start;
                            const auto& every = track.beam.every;
                            const float r = (scale * wp::asin((float)(a / distance[k])) - start.c[0]) * every.c[0];
                            const float q = (scale * wp::asin((float)(b / distance[k])) - start.c[1]) * every.c[1];
                            float parts[2] = {};
                            if (r >= 0.0f && q >= 0.0f && r <= angles - 1 && q <= heights - 1) {
                                const int i = wp::min((int)r, angles - 2), j = wp::max(wp::min((int)q, heights - 2), 0);
                                const int next = wp::min(j + 1, heights - 1);
                                const float u = r - i, v = q - j;
                                const float share[4] = {(1 - u) * (1 - v), (1 - u) * v, u * (1 - v), u * v};
                                for (int n = 0; n < 4; ++n)
                                    for (int c = 0; c < 2; ++c)
                                        parts[c] += share[n] * wp::index(pattern, i + n / 2, n % 2 ? next : j).c[c];
                            }
                            aside[k] = weight * parts[1];
                            gain[k] = weight * parts[0];
                        }
                    } else if (wide || high) {
                        const auto& level = track.beam.along.data[at_pulse];
                        const auto& up = track.beam.up.data[at_pulse];
                        for (int k = 0; k < 8; ++k) {
                            double u = 0.0, v = 0.0;
                            for (int c = 0; c < 3; ++c) {
                                const double to = x[c][k] - place.c[c];
                                u += to * level.c[c];
                                v += to * up.c[c];
                            }
                            float one = 1.0f;
                            const float scale = 2.7834312f / (float)distance[k];
                            const float a = wide ? scale * (float)u / track.beam.wide : 0.0f;
                            const float b = high ? scale * (float)v / track.beam.high : 0.0f;
                            if (wp::abs(a) > 1.0e-4f) one *= wp::sin(a) / a;
                            if (wp::abs(b) > 1.0e-4f) one *= wp::sin(b) / b;
                            gain[k] *= antennas == 1 ? one * one : one;
                        }
                    }
                }
                if (antennas == 2) way *= 0.5;
                const D turns = -turns_per_metre * way;
                const F rest = __builtin_convertvector(turns - __builtin_elementwise_floor(turns + 0.5), F);
                const I quarter = __builtin_convertvector(__builtin_elementwise_floor(4.0f * rest + 0.5f), I);
                const F t = 6.283185307f * (rest - 0.25f * __builtin_convertvector(quarter, F));
                const F y = t * t;
                const F s = t + t * y * (-1.0f / 6.0f + y * (1.0f / 120.0f + y * (-1.0f / 5040.0f + y / 362880.0f)));
                const F c = 1.0f + y * (-0.5f + y * (1.0f / 24.0f + y * (-1.0f / 720.0f + y * (1.0f / 40320.0f))));
                const I odd = (quarter & 1) != 0;
                F cosine = odd ? s : c, sine = odd ? c : s;
                cosine = (((quarter + 1) & 2) != 0) ? -cosine : cosine;
                sine = ((quarter & 2) != 0) ? -sine : sine;
                const F real = cosine * gain - sine * aside;
                sine = sine * gain + cosine * aside;
                cosine = real;
                const D bin = bins_per_metre * way;
                const D inside = bin - period * __builtin_elementwise_floor(bin / period);
                const D floor = __builtin_elementwise_floor(inside);
                // The first bin is floor - 2; a row begins at -3.
                const I first = __builtin_convertvector(floor, I) + 1;
                const F u = STEPS.0f * (1.0f - __builtin_convertvector(inside - floor, F));
                I step = __builtin_convertvector(u, I);
                step = step >= STEPS ? I{} + (STEPS - 1) : step;
                const F share = u - __builtin_convertvector(step, F);
                F values[2 * MOST];
                for (int p = 0; p < pols; ++p) {
                    const F a = *(const F*)(amplitude[2 * p] + 8 * g), b = *(const F*)(amplitude[2 * p + 1] + 8 * g);
                    values[2 * p] = a * cosine - b * sine;
                    values[2 * p + 1] = a * sine + b * cosine;
                }
                for (int k = 0; k < 8; ++k) {
                    const float* entry = table.data + 8 * step[k];
                    const F low = *(const Any*)entry, next = *(const Any*)(entry + 8);
                    const F six = low + share[k] * (next - low);
                    for (int p = 0; p < pols; ++p) {
                        Any* r = (Any*)(re[p] + first[k]);
                        Any* i = (Any*)(im[p] + first[k]);
                        *r += values[2 * p][k] * six;
                        *i += values[2 * p + 1][k] * six;
                    }
                }
            }
        }
    }
""".replace("STEPS", str(TABLE))


@wp.func_native(_DEPOSIT)
def deposit_pulses(
    pulse: wp.array[int],
    weights: wp.array[float],
    track: SensorTrack,
    turns_per_metre: wp.float64,
    bins_per_metre: wp.float64,
    bins: int,
    scatterers: MovingScatterers,
    table: wp.array[float],
    bins_out: wp.array4d[float],
): ...


@wp.kernel(enable_backward=False)
def pulse_deposit_kernel(
    # In:
    pulse_in: wp.array[int],
    weight_in: wp.array[float],
    track: SensorTrack,
    turns_per_metre: wp.float64,
    bins_per_metre: wp.float64,
    bins: int,
    scatterers: MovingScatterers,
    table_in: wp.array[float],
    # Out:
    bins_out: wp.array4d[float],
):
    """One thread: all scatterers into all pulses, (real or imaginary part, polarizations, pulses, bins + SPARE).

    A row begins at bin -3, and does not go round.
    """
    deposit_pulses(
        pulse_in,
        weight_in,
        track,
        turns_per_metre,
        bins_per_metre,
        bins,
        scatterers,
        table_in,
        bins_out,
    )
