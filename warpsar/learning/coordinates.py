"""What x is: the numbers of a scene that a fit may change, their names, bounds and start."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from warpsar.effects.base.fitted import is_fitted
from warpsar.effects.base.parameter import Parameter
from warpsar.effects.registry import get, held_by
from warpsar.errors import InputError
from warpsar.scene.scene import Scene
from warpsar.surface.surface import KINDS, Surface
from warpsar.world.tables import View


@dataclass(frozen=True)
class EffectCoordinate:
    """One number of x that belongs to an effect: a parameter, or its value in one view or on one material."""

    effect: str
    parameter: Parameter
    index: int  # in the effect's array of values
    view: str | None = None
    material: str | None = None

    @property
    def key(self) -> str | None:
        """Where its value stands in the parameter's own table; None for a parameter that is one number."""
        return self.material if self.view is None else self.view

    @property
    def label(self) -> str:
        where = "" if self.key is None else f"[{self.key}]"
        return f"{self.effect}.{self.parameter.name}{where}"


@dataclass(frozen=True)
class DeviceX:
    """An x without effects' parameters, left on the device.

    `nodes` holds the whole surface's nodes, shape (n,), float32; x is the part `learned` of them. NumPy converts it
    to an array of the host, float64.
    """

    nodes: wp.array
    learned: np.ndarray | slice

    def __array__(self, dtype: np.dtype | None = None, copy: bool | None = None) -> np.ndarray:
        return np.array(self.nodes.numpy()[self.learned], dtype or float)


class SceneCoordinates:
    """The parameters of a scene that may change, as one vector x.

    x holds, in this order, the learned surface nodes (ln(eps_r - 1), ln h, ln l, logit tau) and the fit coordinates of
    the declared effects' fitted parameters, per view for the views `chosen`. `x0` is x as the scene declares it, shape
    (p,), float64. Raises InputError for a start at which every derivative is 0.
    """

    def __init__(self, scene: Scene, chosen: Sequence[View]) -> None:
        self.scene, self.chosen = scene, chosen
        self.surface = Surface.of(scene)
        self.learned = self.surface.learned
        self._nodes = self.surface.nodes.astype(np.float32)  # as the device has them
        # as a slice where they are in one piece: a field of a million nodes is then several times as fast to take
        whole = self.learned.size and self.learned[-1] + 1 - self.learned[0] == self.learned.size
        self._learned: np.ndarray | slice = slice(self.learned[0], self.learned[-1] + 1) if whole else self.learned
        self.effect_coordinates = self._effect_coordinates()
        self._tables: dict[str, dict[str, Any]] = {name: dict(table) for name, table in scene.effects.items()}
        self.x0 = np.concatenate([self.surface.nodes[self.learned], self._effect_values(scene.effects)])
        if not np.isfinite(self.x0).all():
            bad = [self.labels[i] for i in np.flatnonzero(~np.isfinite(self.x0))[:5]]
            raise InputError(
                f"{scene.name}: {', '.join(bad)}: found a dead start (eps_r = 1: no reflection, and every derivative "
                f"is exactly 0); allowed is eps_r >= {KINDS[0].low:g}"
            )

    @property
    def labels(self) -> list[str]:
        """A name for every element of x: material.key, with the node's number where there are many."""
        names = []
        for block in self.surface.blocks:
            if block.learn:
                name = f"{block.material}.{block.kind.key}"
                names += [name] if block.size == 1 else [f"{name}[{i}]" for i in range(block.size)]
        return names + [c.label for c in self.effect_coordinates]

    @property
    def uniform(self) -> bool:
        """Whether x is a handful of numbers, not a field."""
        return all(block.size == 1 for block in self.surface.blocks if block.learn)

    @property
    def moved_together(self) -> np.ndarray:
        """The sizes of x's parts that another start moves as a whole: fields, and single numbers."""
        sizes = [block.size for block in self.surface.blocks if block.learn]
        return np.array([*sizes, *(1 for _ in self.effect_coordinates)], int)

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of x, shape (p,) each."""
        ends, sizes = [], []
        for block in self.surface.blocks:
            if block.learn:
                ends.append([float(block.kind.to_coordinate(end)) for end in (block.kind.low, block.kind.high)])
                sizes.append(block.size)
        for c in self.effect_coordinates:
            ends.append(sorted(c.parameter.to_coordinate(v) for v in c.parameter.fit_bounds))
            sizes.append(1)
        low, high = np.repeat(np.reshape(ends, (-1, 2)), sizes, axis=0).T
        return low.copy(), high.copy()

    def nodes(self, x: np.ndarray) -> np.ndarray:
        """The whole surface's nodes with x in place, float64."""
        return self._with(x, self.surface.nodes)

    def float_nodes(self, x: np.ndarray | DeviceX) -> np.ndarray:
        """`nodes` as the device has them, float32."""
        return self._with(np.asarray(x), self._nodes)

    def fill(self, nodes: wp.array, x: np.ndarray | DeviceX) -> None:
        """Write the whole surface's nodes with x in place into the device array `nodes`."""
        if not isinstance(x, DeviceX):
            nodes.assign(self._with(x, self._nodes))
        elif x.nodes is not nodes:
            wp.copy(nodes, x.nodes)

    def on_device(self, nodes: wp.array) -> DeviceX:
        """The x that stands in `nodes`, a device array of the whole surface's nodes."""
        return DeviceX(nodes, self._learned)

    def effect_tables(self, x: np.ndarray | DeviceX) -> dict[str, dict[str, Any]]:
        """The tables `[effects.*]` with x in place."""
        tables = {
            name: {k: dict(v) if isinstance(v, dict) else v for k, v in t.items()} for name, t in self._tables.items()
        }
        # a DeviceX has no such values, and is not copied to the host to find none
        values = np.asarray(x)[self.learned.size :] if self.effect_coordinates else ()
        for c, value in zip(self.effect_coordinates, values, strict=True):
            number = float(c.parameter.from_coordinate(value))
            if c.key is None:
                tables[c.effect][c.parameter.name] = number
            else:
                tables[c.effect][c.parameter.name][c.key] = number
        # only differences act: without the mean over the fitted views, the other views stay as they are
        for (effect, name), views in self._zero_sums().items():
            mean = sum(tables[effect][name][view] for view in views) / len(views)
            for view in views:
                tables[effect][name][view] -= mean
        return tables

    def follow(self, other: SceneCoordinates, x: np.ndarray | DeviceX) -> np.ndarray | DeviceX:
        """The x of `other`, a fit to other views of the scene, as an x of these views.

        Numbers of an effect in these views alone stay as declared.
        """
        self._tables = other.effect_tables(x)
        if not self.effect_coordinates and not other.effect_coordinates:
            return x
        return np.concatenate([np.asarray(x)[: other.learned.size], self._effect_values(self._tables)])

    def _with(self, x: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        found = nodes.copy()
        found[self._learned] = x[: self.learned.size]
        return found

    def _effect_coordinates(self) -> list[EffectCoordinate]:
        found = []
        contained = held_by(self.scene.effects)
        for name, table in self.scene.effects.items():
            for index, parameter in enumerate(get(name).parameters if name not in contained else ()):
                if not is_fitted(parameter.name, table):
                    continue
                if parameter.per_view:
                    names = [v.name for v in self.chosen if v.name in table[parameter.name]]
                    found += [EffectCoordinate(name, parameter, index, view) for view in names]
                elif parameter.per_material:
                    all_of_them = enumerate(self.scene.mesh.materials, index)
                    stated = [(at, m) for at, m in all_of_them if m in table[parameter.name]]
                    found += [EffectCoordinate(name, parameter, at, material=m) for at, m in stated]
                else:
                    found.append(EffectCoordinate(name, parameter, index))
        return found

    def _effect_values(self, tables: Mapping[str, Mapping[str, Any]]) -> np.ndarray:
        """The effects' part of x that stands in `tables`."""
        values = []
        for c in self.effect_coordinates:
            value = tables[c.effect][c.parameter.name]
            values.append(c.parameter.to_coordinate(value if c.key is None else value[c.key]))
        return np.array(values, float)

    @property
    def zero_sum_means(self) -> np.ndarray:
        """Directions in x that change nothing by definition, shape (n, p): the mean of values that sum to zero."""
        first = self.learned.size
        rows = np.zeros((len(self._zero_sums()), first + len(self.effect_coordinates)))
        for row, key in zip(rows, self._zero_sums(), strict=True):
            mine = [(c.effect, c.parameter.name) == key for c in self.effect_coordinates]
            row[first:] = np.array(mine, float) / np.sqrt(sum(mine))
        return rows

    def _zero_sums(self) -> dict[tuple[str, str], list[str]]:
        """The fitted views of every per-view parameter whose values sum to zero.

        A single fitted view is free: it moves against the views whose values are known.
        """
        found: dict[tuple[str, str], list[str]] = {}
        for c in self.effect_coordinates:
            if c.parameter.zero_sum and c.view is not None:
                found.setdefault((c.effect, c.parameter.name), []).append(c.view)
        return {key: views for key, views in found.items() if len(views) > 1}
