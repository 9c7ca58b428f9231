"""95 % intervals of surface parameters: the profile of the likelihood over all surfaces that a fit may take.

Permittivity, height and correlation length of a surface trade along valleys that are bent, and there may be several of
them. A standard deviation knows one valley, and takes it to be straight. So all that lies within a fit's bounds is
searched.

Images know a material by its curve alone: what its sigma0 is at each incidence that they see. So hits of like angles
are one kind, and the likelihood is expanded once, to second order, in the logarithms of what all kinds bring. A surface
anywhere within the bounds then costs its sigma0 at a few dozen angles, and no image. Everything else that is fitted
is free beside it, to first order: effects, the level of what comes over several surfaces, and other materials, which
stay within their bounds. The interval has all values beside which some surface stays within what speckle alone explains
in 95 % of images: 3.84 of 2 ln L, times what correlated speckle adds to a variance.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np
import warp as wp
from scipy.ndimage import minimum_filter
from scipy.sparse import coo_array

from warpsar.effects.base.effect import DeclaredEffect
from warpsar.kernels.codes import Spectrum
from warpsar.learning.identify import Z_95, Identified
from warpsar.learning.prior import Known
from warpsar.learning.problem import FitProblem
from warpsar.learning.view import FitView
from warpsar.render.render import ViewRender
from warpsar.surface.surface import places_of
from warpsar.trace.hits import ARRAYS, Hits

CELLS = 0.5, 0.02, 0.05  # of hits of one kind: incidence [deg], cosine of the twist squared, `cos2_azimuth`
MOST_KINDS = 64  # of a view: with more, cells are twice as wide, and so on
ANGLES = "cos_incidence", "cos_twist", "cos2_azimuth"
LEAST_SHARE = 1e-4  # of a material's power in a view: less is no kind, and stands as it was fitted
AT_ONCE = 2048  # hits that are shaded together
TRIED, MOST_VALUES = 4096, 48  # surfaces on the grid over the box, and values of an element there
STARTS = 3  # of each value that is held, and four times as many of free surfaces
APART = 0.5  # in a coordinate: likeliest surfaces that are nearer to each other are one
HOPELESS = 0.05  # of what a surface must still gain to fit: a step of a descent that gains less is its last
TURNS = 3  # of all profiles, where one comes upon a likelier surface
SWEEPS = 6  # over values that are refused beside one that fits: its valley may go on to them
STEPS, LONGEST = 30, 2.0  # of a descent, and its longest step in a coordinate
FLAT = 1e-4  # of 2 ln L: a descent that gains less has ended
CLOSE, HALVINGS = 0.02, 10  # of the root of what 2 ln L falls by: an end that is off by less is found
TINY = 1e-35  # sigma0 that float32 still holds
BENDS = np.linspace(-8.0, 8.0, 401)  # the change d of a logarithm is BEND sinh of one of them
BEND = 0.05
SHARES = np.geomspace(1e-4, 1.0, 33)  # of a material in a pixel: edges of classes


def with_profiles(problem: FitProblem, x: np.ndarray, identified: Identified) -> Identified:
    """`identified` with `ends`: of every element of x the 95 % interval, shape (p, 2), in the coordinates of x.

    An end of a surface's parameter that no value within the bounds refuses is the bound; where all values fit, both
    ends are infinite, and `by_profile` is true. What correlated speckle adds to a variance (the sandwich over the
    inverse information) divides the gain in likelihood that it is held against. Priors count.

    Numbers of effects have 1.96 standard deviations to either side. So have surfaces where the search is not possible:
    hits that are not at hand, views on several processes, soft constraints of `--validity`.
    """
    ends = x[:, None] + np.array([-Z_95, Z_95]) * identified.sd[:, None]
    by_profile = np.zeros(x.size, bool)
    if x.size and problem.slopes_tell_all:
        wider = _wider(identified)
        low, high = problem.bounds
        for curves in _curves(problem, x):
            mine = curves.elements
            box = np.stack([low, high], axis=1)
            room = box[curves.others] - x[curves.others, None]
            found = _Search(curves, box[mine], wider[mine], x[mine], room).ends()
            found[(found == box[mine]).all(axis=1)] = -np.inf, np.inf
            ends[mine], by_profile[mine] = found, True
    return replace(identified, ends=ends, by_profile=by_profile)


def _wider(identified: Identified) -> np.ndarray:
    """By what the variance of each element exceeds that of independent pixels, shape (p,)."""
    scale = np.sqrt(np.maximum(np.diag(identified.information), 1e-300))
    unit = identified.information / np.outer(scale, scale)
    alone = np.diag(np.linalg.pinv(unit, rcond=1e-9, hermitian=True)) / scale**2
    with np.errstate(divide="ignore", invalid="ignore"):
        wider = identified.sd**2 / alone
    known = np.isfinite(wider) & (wider > 0.0)
    return np.where(known, wider, np.median(wider[known]) if known.any() else 1.0)


# ---- the likelihood of curves ----


@dataclass(frozen=True)
class _Kinds:
    """Kinds of hits of one view: a hit of each, its material's number, and the kind's mean `ANGLES`, (3, kinds)."""

    view: FitView
    render: ViewRender
    hit: np.ndarray
    material: np.ndarray
    angles: np.ndarray

    @property
    def of_surfaces(self) -> list[DeclaredEffect]:
        """The effects that act on surfaces."""
        return [one for one in self.view.effects if one.effect.stage == "surface"]

    def of_material(self, m: int) -> _Kinds:
        mine = self.material == m
        return replace(self, hit=self.hit[mine], material=self.material[mine], angles=self.angles[:, mine])

    def coordinates(self) -> np.ndarray:
        """Learned coordinates of the hits before any effect, shape (n, p)."""
        pages = [one.zeta.numpy()[self.hit] for one in self.render.gathered[: len(self.render.stage.node_maps)]]
        return np.concatenate(pages, axis=1).astype(float)

    @classmethod
    def of(cls, view: FitView, render: ViewRender, materials: Sequence[int]) -> tuple[_Kinds, np.ndarray, int]:
        """With the kind of each shading sample, and how many there are."""
        hits, surface = render.shaded, render.stage.surface
        material = render.stage.face_material.numpy()[hits.face.numpy()]
        cosine, twist, azimuth = (getattr(hits, name).numpy().astype(float) for name in ANGLES)
        power = hits.weight.numpy() * sum(sigma.numpy() for sigma in render.sigma.values()).astype(float)
        share = power / np.maximum(np.bincount(material, power), 1e-300)[material]
        lies = ((surface.spectrum == Spectrum.SEPARABLE) | (surface.aspect != 1.0))[material]
        at = np.stack([np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))), twist**2, azimuth], axis=1)
        mine = np.flatnonzero(np.isin(material, materials))
        cells = at[mine] / CELLS * np.stack([np.ones(mine.size), np.ones(mine.size), lies[mine]], axis=1)
        while True:
            keys = np.concatenate([material[mine, None], np.floor(cells).astype(int)], axis=1)
            _, kind = np.unique(keys, axis=0, return_inverse=True)
            kind = kind.ravel()
            keeps = np.bincount(kind, share[mine]) > LEAST_SHARE
            if keeps.sum() <= MOST_KINDS:
                break
            cells /= 2.0
        number = np.where(keeps, np.cumsum(keeps) - 1, -1)
        of_samples = np.full(material.size, -1)
        of_samples[mine] = number[kind]
        count = int(keeps.sum())
        mine = np.flatnonzero(of_samples >= 0)
        kind = of_samples[mine]
        total = np.bincount(kind, power[mine], count)
        middle = np.stack([np.bincount(kind, power[mine] * one, count) for one in at[mine].T], axis=1) / total[:, None]
        off = (((at[mine] - middle[kind]) / CELLS) ** 2).sum(axis=1)
        order = np.lexsort((off, kind))
        hit = mine[order[np.searchsorted(kind[order], np.arange(count))]]
        degrees, square, azimuth = middle.T
        angles = np.stack([np.cos(np.radians(degrees)), np.sqrt(square), azimuth])
        return cls(view, render, hit, material[hit], angles), of_samples, count


class _Shading(ViewRender):
    """sigma0 of some hits at coordinates that are given to it, with the effects that act on surfaces."""

    def __init__(self, like: _Kinds, hits: Hits, polarizations: Sequence[str]) -> None:
        self.given: list[wp.array] = []
        stage, shape = like.render.stage, like.render.shape
        super().__init__(stage, like.view.view, hits, shape, tuple(polarizations), like.of_surfaces)
        values = {e.effect.name: like.render.effect_values[e.effect.name].numpy() for e in like.of_surfaces}
        self.set_parameters(None, values)

    def _gather(self, face: wp.array, barycentric: wp.array, page: int) -> wp.array:
        self.given.append(self.program.array(face.shape[0], wp.vec4))
        return self.given[-1]

    def at(self, coordinates: np.ndarray, slopes: bool) -> Iterator[np.ndarray]:
        """Of each polarization, at coordinates of shape (n, p): sigma0 and, where asked for, its `slopes` to them,
        shape (n, 1 + p) or (n, 1), float64."""
        pages = np.split(coordinates.astype(np.float32), len(self.given), axis=1)
        for array, values in zip(self.given, pages, strict=True):
            array.assign(np.ascontiguousarray(values))
        for sigma in self.sigma.values():
            part = self.program.part([sigma], self.given)
            part.forward(gradient=slopes)
            columns = [sigma.numpy()[:, None]]
            if slopes:
                part.backward({sigma: 1.0})
                columns += [array.grad.numpy() for array in self.given]
            yield np.concatenate(columns, axis=1, dtype=float)


@dataclass
class _Curves:
    """The likelihood of one material's curves, of which the elements `elements` of x decide, q of them.

    -ln L is d' `information` d / 2 - `score` d beside the curves as fitted, at `fitted`, (q,). d is the change of their
    logarithms, `bent`, shape (curve,): polarization by polarization, and kind by kind. Behind these it has how far the
    elements `others` of x, of other materials, lie from the fit. A surface has its own q elements, and then these: p.
    `place`, (q,): of each element among the coordinates of a hit. `kinds`: those of each view that are the material's.
    `known` counts among its own elements.
    """

    elements: np.ndarray
    others: np.ndarray
    place: np.ndarray
    fitted: np.ndarray
    information: np.ndarray
    score: np.ndarray
    kinds: Sequence[_Kinds]
    polarizations: Sequence[str]
    known: Sequence[Known]
    bent: _Bent

    def __post_init__(self) -> None:
        self._rows = max(1, AT_ONCE // max(sum(one.hit.size for one in self.kinds), 1))
        apart = any(one.of_surfaces for one in self.kinds)  # they may take a view's axes
        groups: dict[object, list[int]] = {}
        for k, one in enumerate(self.kinds):
            if one.hit.size:
                groups.setdefault(k if apart else one.render.geometry.wavenumber, []).append(k)
        # as many surfaces at once as `_rows`, all of their hits one after the other
        self._parts = []
        for group in groups.values():
            mine = [self.kinds[k] for k in group]
            shading = _Shading(mine[0], _repeated(mine, self._rows), self.polarizations)
            self._parts.append((shading, np.concatenate([one.coordinates() for one in mine])))
        # curves are in the order of views
        view = [k for group in groups.values() for k in group for _ in self.kinds[k].hit]
        self._order = np.argsort(view, kind="stable")
        self._count = self.score.size - self.others.size
        self._base = np.zeros(self._count)
        self._base = self._logarithms(self.fitted[None], False)[0][0]

    def _logarithms(self, at: np.ndarray, slopes: bool) -> tuple[np.ndarray, np.ndarray]:
        """ln sigma0 over that of the fit, (n, curve), and its slopes, (n, curve, q), of surfaces `at`, (n, p)."""
        q = len(self.place) if slopes else 0
        whole = np.zeros((len(at), self._count, 1 + q))
        for first in range(0, len(at) if self._parts else 0, self._rows):
            some = at[first : first + self._rows]
            found = zip(*(shading.at(self._filled(some, own), slopes) for shading, own in self._parts), strict=True)
            columns = [0, *(1 + self.place)] if slopes else [0]
            channels = [
                np.concatenate([one.reshape(self._rows, -1, one.shape[1])[: len(some)] for one in parts], axis=1)
                for parts in found
            ]
            whole[first : first + len(some)] = np.concatenate([one[:, self._order] for one in channels], axis=1)[
                ..., columns
            ]
        sigma = np.maximum(whole[..., 0], TINY)
        return np.log(sigma) - self._base, np.where(whole[..., :1] > TINY, whole[..., 1:] / sigma[..., None], 0.0)

    def _filled(self, some: np.ndarray, own: np.ndarray) -> np.ndarray:
        """Coordinates of all hits of a part for the surfaces `some`; beyond these the last one stands again."""
        found = np.repeat(own[None], self._rows, axis=0)
        own = some[:, : self.place.size]
        found[: len(some), :, self.place] = own[:, None, :]
        found[len(some) :, :, self.place] = own[-1]
        return found.reshape(-1, found.shape[2])

    def losses(self, at: np.ndarray) -> np.ndarray:
        """-ln L of surfaces `at`, (n, p), beside that of the fit, (n,)."""
        raw, _ = self._logarithms(at, False)
        d = np.concatenate([self.bent.of(raw)[0], at[:, self.place.size :]], axis=1)
        loss = self._of(d @ self.information, d) + sum(0.5 * off**2 for _, off, _ in self._priors(at))
        return np.asarray(np.where(self._dark(raw), np.inf, loss))

    def expanded(self, at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """`losses` with their gradients, (n, p), and curvatures, (n, p, p)."""
        raw, slopes = self._logarithms(at, True)
        d, bend = self.bent.of(raw)
        n, q, r = len(at), self.place.size, self.others.size
        whole = np.zeros((n, self.score.size, q + r))
        whole[:, : self._count, :q] = slopes * bend[..., None]
        whole[:, self._count :, q:] = np.eye(r)
        d, slopes = np.concatenate([d, at[:, q:]], axis=1), whole
        pulled, across = d @ self.information, slopes.transpose(0, 2, 1)
        loss = self._of(pulled, d)
        gradient = (across @ (pulled - self.score)[..., None])[..., 0]
        curvature = across @ (self.information @ slopes)
        for k, off, slope in self._priors(at):
            loss += 0.5 * off**2
            gradient[:, k] += off * slope
            curvature[:, k, k] += slope**2
        return np.where(self._dark(raw), np.inf, loss), gradient, curvature

    def _dark(self, raw: np.ndarray) -> np.ndarray:
        """Surfaces that send less back than float32 holds, where a level is free and it would pass for a level."""
        return (raw + self._base <= np.log(TINY)).any(axis=1) & (not self.bent.bends)

    def _of(self, pulled: np.ndarray, d: np.ndarray) -> np.ndarray:
        return np.asarray(np.sum((0.5 * pulled - self.score) * d, axis=1))

    def _priors(self, at: np.ndarray) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
        """Of each known element: its place, deviations in standard deviations, (n,), and their slopes."""
        for one in self.known:
            own = at[:, one.at].tolist()
            value, slope = (np.array([of(x) for x in own], float) for of in (one.value, one.slope))
            yield one.at, (value - one.about) / one.sd, slope / one.sd


@dataclass(frozen=True)
class _Bent:
    """Logarithms of power bent so that the likelihood is a parabola along each.

    In a pixel of which the material has the share S, power that changes by e^d costs ln m + 1 / m - 1 of the gamma
    likelihood, m = 1 + S (e^d - 1), and not S^2 d^2 / 2. Less power can at most take the share away, and more of it is
    soon more than the pixel has. `values`, shape (curve, BENDS), are the roots of twice that, of all pixels of a kind
    together, over that of their information.
    """

    values: np.ndarray
    bends: bool = True

    @classmethod
    def over(cls, weights: np.ndarray | None, count: int) -> _Bent:
        """`weights`: of each curve's pixels in each class of `SHARES`, (curve, classes); None: nothing is bent."""
        d = BEND * np.sinh(BENDS)
        if weights is None:
            return cls(np.tile(d, (count, 1)), bends=False)
        share = np.sqrt(SHARES[1:] * SHARES[:-1])
        share[-1] = 1.0  # most pixels have one material
        power = (1.0 - share[:, None]) + share[:, None] * np.exp(d)
        cost = np.log(power) + 1.0 / power - 1.0
        precision = np.maximum(weights @ share**2, 1e-300)
        bent = np.sign(d) * np.sqrt(np.maximum(2.0 * (weights @ cost) / precision[:, None], 0.0))
        return cls(np.where(weights.sum(axis=1, keepdims=True) > 0.0, bent, d))

    def of(self, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The bent logarithms of d, shape (n, curve), and their slopes."""
        ends = BEND * np.sinh(BENDS[[0, -1]])
        at = (np.arcsinh(np.clip(d, *ends) / BEND) - BENDS[0]) / (BENDS[1] - BENDS[0])
        left = np.clip(at.astype(int), 0, BENDS.size - 2)
        curve = np.arange(d.shape[1])
        low, high = self.values[curve, left], self.values[curve, left + 1]
        first, last = (BEND * np.sinh(BENDS[left + k]) for k in (0, 1))
        slope = (high - low) / (last - first)
        return low + slope * (np.clip(d, *ends) - first), slope


def _repeated(group: Sequence[_Kinds], times: int) -> Hits:
    """The hits of all kinds of some views, one after the other, and all of them so many `times`."""
    like = group[0].render.shaded
    arrays = dict[str, Any]()
    for name, dtype in ARRAYS.items():
        if name in ANGLES:
            values = np.concatenate([one.angles[ANGLES.index(name)] for one in group]).astype(np.float32)
        else:
            values = np.concatenate([getattr(one.render.shaded, name).numpy()[one.hit] for one in group])
        arrays[name] = wp.array(np.concatenate([values] * times), dtype=dtype, device=like.pixel.device)
    arrays["pixel"].zero_()  # nothing is put into an image
    return replace(like, **arrays, derived={})


def _curves(problem: FitProblem, x: np.ndarray) -> Iterator[_Curves]:
    """The likelihood of the curves of every material that is learned; none where it cannot be had."""
    surface, own = problem.surface, dict[int, list[tuple[int, int]]]()
    for at, block in enumerate(block for block in surface.blocks if block.learn):
        m = surface.materials.index(block.material)
        keys = [kind.key for kind in places_of(surface.model[m])]
        own.setdefault(m, []).append((at, keys.index(block.kind.key)))
    found = problem.by_kind(x, lambda view, render: _Kinds.of(view, render, list(own)))
    if found is None:
        return
    modelled, jacobians = problem.linearised(x)
    polarizations = list(dict.fromkeys(seen.polarization for seen in problem.observations))
    count = sum(kinds.hit.size for kinds, _ in found)
    first = len(polarizations) * count
    size = first + x.size + len(modelled)
    information, score = np.zeros((size, size)), np.zeros(size)
    observed = zip(problem.observations, jacobians, problem.curvatures(modelled), strict=True)
    bends = problem.loss == "gamma" and problem.scene.grid.calibrated
    pixels = np.zeros((first, SHARES.size - 1))
    start, number = 0, 0
    for kinds, shares in found:
        for share, (seen, jacobian, curved) in zip(shares, islice(observed, len(shares)), strict=True):
            if not problem.scene.grid.calibrated:
                share = share - np.average(share, axis=0, weights=curved.weight)
            columns = np.concatenate([share, jacobian], axis=1)
            begin = polarizations.index(seen.polarization) * count + start
            of_kinds = np.arange(begin, begin + kinds.hit.size)
            pixels[of_kinds] = _classes(share[:, :-1], kinds.material, curved.weight)
            places = np.concatenate([of_kinds, [first + x.size + number], np.arange(first, first + x.size)])
            weighted = curved.weight[:, None] * columns
            information[np.ix_(places, places)] += columns.T @ weighted
            score[places] += weighted.T @ curved.residual
            number += 1
        start += kinds.hit.size
    of_x = slice(first, first + x.size)
    information[of_x, of_x] += problem.prior.information(x)
    score[of_x] -= problem.prior.gradient(x)
    material = np.tile(np.concatenate([kinds.material for kinds, _ in found]), len(polarizations))
    for m, elements in own.items():
        mine, place = (np.array(each) for each in zip(*elements, strict=True))
        curve = np.flatnonzero(material == m)
        surfaces = np.array([k for one in own.values() for k, _ in one])
        others = np.setdiff1d(surfaces, mine)
        rest = np.setdiff1d(np.arange(first, size), first + surfaces)
        known = [replace(k, at=int(np.flatnonzero(mine == k.at)[0])) for k in problem.prior.known if k.at in mine]
        yield _Curves(
            mine,
            others,
            place,
            x[mine],
            *_beside(information, score, np.concatenate([curve, first + others]), rest),
            [kinds.of_material(m) for kinds, _ in found],
            polarizations,
            known,
            _Bent.over(pixels[curve] if bends else None, curve.size),
        )


def _classes(share: np.ndarray, material: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """How much of the pixels' `weight` each kind has where its material has a share of each class, (kinds, classes).

    `share`, (pixels, kinds), is that of each kind, `material` the kinds'.
    """
    found = np.zeros((material.size, SHARES.size - 1))
    for m in np.unique(material):
        mine = np.flatnonzero(material == m)
        own = np.maximum(share[:, mine], 0.0)
        whole = own.sum(axis=1)
        lit = np.flatnonzero(whole > SHARES[0])
        sort = np.clip(np.searchsorted(SHARES, whole[lit]) - 1, 0, SHARES.size - 2)
        part = coo_array((weight[lit] / whole[lit], (sort, lit)), (SHARES.size - 1, len(share)))
        found[mine] = (part @ own).T
    return found


def _beside(
    information: np.ndarray, score: np.ndarray, mine: np.ndarray, others: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Information and score of `mine` where `others` are free (Schur's complement)."""
    inner = information[np.ix_(others, others)]
    scale = np.sqrt(np.maximum(np.diag(inner), 1e-300))
    inverse = np.linalg.pinv(inner / np.outer(scale, scale), rcond=1e-9, hermitian=True) / np.outer(scale, scale)
    across = information[np.ix_(mine, others)] @ inverse
    return (
        information[np.ix_(mine, mine)] - across @ information[np.ix_(others, mine)],
        score[mine] - across @ score[others],
    )


# ---- the search of a box ----


class _Search:
    """Profiles of one material's likelihood over its whole `box`, shape (q, 2), from the fit at `x`, (q,).

    `wider`, (q,): what 2 ln L is divided by.
    """

    def __init__(
        self, curves: _Curves, box: np.ndarray, wider: np.ndarray, x: np.ndarray, room: np.ndarray | None = None
    ) -> None:
        room = np.zeros((0, 2)) if room is None else room
        self._curves, self._wider, q = curves, wider, len(box)
        self._own, self._box = q, np.concatenate([box, room])
        self._x = np.concatenate([np.clip(x, *box.T), np.zeros(len(room))])
        values = int(np.clip(round(TRIED ** (1.0 / q)), 3, MOST_VALUES))
        self._axes = [np.linspace(low, high, values) for low, high in box]
        grid = np.stack(np.meshgrid(*self._axes, indexing="ij"), axis=-1)
        self._grid = np.concatenate([grid, np.zeros((*grid.shape[:-1], len(room)))], axis=-1)
        self._losses = curves.losses(self._grid.reshape(-1, q + len(room))).reshape(grid.shape[:-1])
        self._least = 0.0
        lowest = self._lowest(self._losses, self._grid, 4 * STARTS)
        free, losses = self._descended(np.concatenate([self._x[None], lowest]), np.ones(len(self._box), bool))
        self._least = float(losses.min())
        fit = losses <= self._least + self._limit(wider.max())
        self._free = _apart(free[fit][np.argsort(losses[fit])], q)

    @staticmethod
    def _limit(wider: float | np.ndarray) -> float | np.ndarray:
        """By how much -ln L may fall."""
        return 0.5 * Z_95**2 * wider

    @staticmethod
    def _lowest(losses: np.ndarray, places: np.ndarray, count: int) -> np.ndarray:
        """The lowest `count` local minima of a grid, shape (n, q)."""
        valleys = np.flatnonzero((losses == minimum_filter(losses, size=3, mode="nearest")).ravel())
        best = valleys[np.argsort(losses.ravel()[valleys], kind="stable")[:count]]
        return np.asarray(places.reshape(-1, places.shape[-1])[best])

    def _descended(self, start: np.ndarray, moving: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where Levenberg-Marquardt's method leads to within the box, from each of `start`, (n, q), and the losses.

        Coordinates move where `moving`, (n, q) or (q,), says so.
        """
        at, damping = np.clip(start, *self._box.T), np.full(len(start), 1e-3)
        moving = np.broadcast_to(moving, at.shape)
        loss, gradient, curvature = self._curves.expanded(at)
        busy = np.arange(len(at))
        for _ in range(STEPS):
            here, slope, bend = at[busy], gradient[busy], curvature[busy].copy()
            low, high = self._box.T
            held = ~moving[busy] | ((here <= low) & (slope > 0)) | ((here >= high) & (slope < 0))
            slope = np.where(held, 0.0, slope)
            bend[held[:, :, None] | held[:, None, :]] = 0.0
            own = np.einsum("nqq->nq", bend)
            scale = np.sqrt(np.where(held | (own <= 0.0), 1.0, own))
            unit = bend / scale[:, :, None] / scale[:, None, :]
            unit[:, range(len(low)), range(len(low))] = 1.0 + damping[busy, None]
            step = -np.linalg.solve(unit, (slope / scale)[..., None])[..., 0] / scale
            step /= np.maximum(np.abs(step).max(axis=1, keepdims=True) / LONGEST, 1.0)
            there = np.where(held, here, np.clip(here + step, low, high))
            new = self._curves.expanded(there)
            better = new[0] < loss[busy]
            gained = np.where(better, loss[busy], 0.0) - np.where(better, new[0], 0.0)
            moved = busy[better]
            at[moved], loss[moved] = there[better], new[0][better]
            gradient[moved], curvature[moved] = new[1][better], new[2][better]
            far = loss[busy] - self._least - self._limit(self._wider.max())
            ended = np.where(better, gained < np.maximum(0.5 * FLAT, HOPELESS * far), damping[busy] > 1e6)
            damping[busy] = np.clip(damping[busy] * np.where(better, 0.1, 10.0), 1e-6, 1e8)
            busy = busy[~ended]
            if not busy.size:
                break
        return at, loss

    def ends(self) -> np.ndarray:
        """Both ends of each interval, shape (q, 2); those at the box's ends are its own."""
        for _ in range(TURNS):
            held, found = zip(*(self._profile(k) for k in range(self._own)), strict=True)
            places, losses = (np.concatenate(each) for each in zip(*found, strict=True))
            if losses.min() > self._least - 0.5 * FLAT:
                break
            # the likeliest surface was not among those that were started from
            self._least = float(losses.min())
            self._free = _apart(np.concatenate([places[None, losses.argmin()], self._free]), self._own)
        x, ends, sought = self._x[: self._own], self._box[: self._own].copy(), list[_End]()
        for k, (values, (places, losses)) in enumerate(zip(held, found, strict=True)):
            roots = self._roots(k, losses)
            fits = np.flatnonzero(roots <= max(Z_95, float(roots.min())))
            for side, (inner, outer) in enumerate(((fits[0], fits[0] - 1), (fits[-1], fits[-1] + 1))):
                if 0 <= outer < values.size:
                    sought.append(_End(k, side, *(_Held(places[i], float(roots[i])) for i in (inner, outer))))
        for one in self._refined(sought):
            ends[one.element, one.side] = one.inside.place[one.element]
        return np.stack([np.minimum(ends[:, 0], x), np.maximum(ends[:, 1], x)], axis=1)

    def _roots(self, k: int | np.ndarray, losses: np.ndarray) -> np.ndarray:
        return np.sqrt(np.maximum(2.0 * (losses - self._least) / self._wider[k], 0.0))

    def _profile(self, k: int) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
        """Values of element k over the whole box, (n,), and the likeliest surfaces beside each, with their losses."""
        values = np.unique(np.concatenate([self._axes[k], self._free[:, k]]))
        nearest = np.abs(values[:, None] - self._axes[k]).argmin(axis=1)
        starts, of = [], []
        for i, slab in enumerate(nearest):
            low = self._lowest(np.take(self._losses, slab, axis=k), np.take(self._grid, slab, axis=k), STARTS)
            starts += [low, self._free, self._x[None]]
            of += [i] * (len(low) + len(self._free) + 1)
        best, losses = self._held(k, values, np.concatenate(starts), np.array(of))
        for _ in range(SWEEPS):
            fits = losses <= self._least + self._limit(self._wider[k])
            pairs = [(i, j) for i in np.flatnonzero(~fits) for j in (i - 1, i + 1) if 0 <= j < values.size and fits[j]]
            if not pairs:
                break
            to, by = np.array(pairs).T
            places, new = self._held(k, values[to], best[by], np.arange(len(to)))
            lower = new < losses[to] - 0.5 * FLAT
            best[to[lower]], losses[to[lower]] = places[lower], new[lower]
            if not (new[lower] <= self._least + self._limit(self._wider[k])).any():
                break
        return values, (best, losses)

    def _held(self, k: int, values: np.ndarray, starts: np.ndarray, of: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The likeliest surface with element k at each of the `values`; each of `starts` is for the value `of` it."""
        starts = starts.copy()
        starts[:, k] = values[of]
        places, losses = self._descended(starts, np.arange(len(self._box)) != k)
        order = np.lexsort((losses, of))
        first = order[np.searchsorted(of[order], np.arange(values.size))]
        return places[first], losses[first]

    def _refined(self, sought: list[_End]) -> list[_End]:
        """The ends, all at once: each between a value that fits and one that does not."""
        for _ in range(HALVINGS):
            open_ones = [one for one in sought if not one.found]
            if not open_ones:
                break
            shares = np.array([one.share for one in open_ones])
            inside, outside = (
                np.array([getattr(one, name).place for one in open_ones]) for name in ("inside", "outside")
            )
            between = inside + shares[:, None] * (outside - inside)
            element = np.array([one.element for one in open_ones])
            n = np.arange(len(open_ones))
            starts = np.concatenate([between, inside, outside])
            rows = np.tile(n, 3)
            starts[np.arange(len(starts)), element[rows]] = between[n, element][rows]
            places, losses = self._descended(starts, np.arange(len(self._box)) != element[rows][:, None])
            least = losses.reshape(3, -1).argmin(axis=0) * len(n) + n
            for one, place, root in zip(open_ones, places[least], self._roots(element, losses[least]), strict=True):
                one.meet(_Held(place, float(root)))
        return sought


def _apart(places: np.ndarray, q: int) -> np.ndarray:
    """Those of `places`, (n, p), that lie apart in their first q elements from all before them."""
    kept, own = [0], places[:, :q]
    for i in range(1, len(places)):
        if np.abs(own[i] - own[kept]).max(axis=1).min() > APART:
            kept.append(i)
    return np.asarray(places[kept])


@dataclass(frozen=True)
class _Held:
    """The likeliest surface with one element held, and the root of what 2 ln L falls by."""

    place: np.ndarray
    root: float


@dataclass
class _End:
    """An end of the interval of an element, the lower (`side` 0) or the upper one, between two values of it."""

    element: int
    side: int
    inside: _Held
    outside: _Held

    @property
    def found(self) -> bool:
        gap = abs(self.outside.place[self.element] - self.inside.place[self.element])
        return Z_95 - self.inside.root < CLOSE * Z_95 or gap < 1e-4

    @property
    def share(self) -> float:
        """Where between the two the root would be `Z_95`, if it rose evenly."""
        rise = self.outside.root - self.inside.root
        return float(np.clip((Z_95 - self.inside.root) / rise, 0.02, 0.9)) if np.isfinite(rise) and rise > 0 else 0.5

    def meet(self, new: _Held) -> None:
        if new.root <= Z_95:
            self.inside = new
        else:
            self.outside = new
