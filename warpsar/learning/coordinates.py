"""What x is: the numbers of a scene that a fit may change, their names, bounds and start."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from warpsar.effects.base.parameter import EffectParameter
from warpsar.effects.registry import get, held_by
from warpsar.errors import InputError
from warpsar.learning.device_values import DeviceValues
from warpsar.parameters.parameter import Parameter
from warpsar.scene.scene import Scene
from warpsar.surface.surface import KINDS, Surface
from warpsar.world.tables import OF_STACKS, View


@dataclass(frozen=True)
class EffectCoordinate:
    """One number of x that belongs to an effect: a parameter, or its value in one view or on one material.

    `declared` is what the effect's class says of it, and `index` its place in the effect's array of values.
    """

    parameter: Parameter
    declared: EffectParameter
    index: int

    @property
    def effect(self) -> str:
        return self.parameter.owner

    @property
    def key(self) -> str:
        """The key in scene.toml."""
        return self.parameter.key

    @property
    def entry(self) -> str | None:
        """Where its value stands in the key's own table; None for a parameter that is one number."""
        return self.parameter.entry

    @property
    def view(self) -> str | None:
        """The only view that it acts on."""
        return self.parameter.entry if self.parameter.layout == "per view" else None

    @property
    def label(self) -> str:
        return self.parameter.old_name


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

    x holds, in this order, the learned surface nodes (ln(eps_r - 1), ln h, ln l, logit tau), the fit coordinates of
    the declared effects' fitted parameters, per view for the views `chosen`, and the coordinates z of `values`: tables
    and learned terms. `x0` is x as the scene declares it, shape (p,), float64; `of_effects` and `of_values` are the
    places of its last two parts. Raises InputError for a start at which every derivative is 0.
    """

    def __init__(self, scene: Scene, chosen: Sequence[View], values: DeviceValues | None = None) -> None:
        for name, material in scene.materials.items():
            if of_curves := [key for key in material.learn if key in OF_STACKS]:
                raise InputError(
                    f"{scene.name}: materials.{name}.learn: found {', '.join(of_curves)}; an image of power does not "
                    f"depend on it, so it is learned from curves of RCS alone, in a scene without images"
                )
        self.scene, self.chosen, self.values = scene, chosen, values or DeviceValues()
        self.surface = Surface.of(scene)
        self.learned = self.surface.learned
        learned = [block for block in self.surface.blocks if block.learn]
        names = [f"materials.{block.material}.{block.kind.key}" for block in learned]
        self._fields = [(scene.parameters[name], block.size) for name, block in zip(names, learned, strict=True)]
        self._nodes = self.surface.nodes.astype(np.float32)  # as the device has them
        # as a slice where they are in one piece: a field of a million nodes is then several times as fast to take
        whole = self.learned.size and self.learned[-1] + 1 - self.learned[0] == self.learned.size
        self._learned: np.ndarray | slice = slice(self.learned[0], self.learned[-1] + 1) if whole else self.learned
        self.effect_coordinates = self._effect_coordinates()
        self._tables: dict[str, dict[str, Any]] = {name: dict(table) for name, table in scene.effects.items()}
        first, last = self.learned.size, self.learned.size + len(self.effect_coordinates)
        self.of_effects, self.of_values = slice(first, last), slice(last, last + self.values.start.size)
        own = self.surface.nodes[self.learned], self._effect_values(scene.effects), self.values.start
        self.x0 = np.concatenate(own)
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
        for parameter, size in self._fields:
            name = parameter.old_name
            names += [name] if size == 1 else [f"{name}[{i}]" for i in range(size)]
        return names + [c.label for c in self.effect_coordinates] + self.values.labels

    def numbers(self) -> Iterator[tuple[int, Parameter]]:
        """The parameters that are one number of x, each with its place."""
        at = 0
        for parameter, size in self._fields:
            if size == 1:
                yield at, parameter
            at += size
        yield from enumerate((c.parameter for c in self.effect_coordinates), at)

    @property
    def uniform(self) -> bool:
        """Whether x is a handful of numbers, not a field."""
        return all(size == 1 for _, size in self._fields)

    @property
    def moved_together(self) -> np.ndarray:
        """The sizes of x's parts that another start moves as a whole: fields, and single numbers."""
        numbers = (1 for _ in range(self.x0.size - self.learned.size))
        return np.array([*(size for _, size in self._fields), *numbers], int)

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of x, shape (p,) each."""
        parts = [*self._fields, *((c.parameter, 1) for c in self.effect_coordinates)]
        ends = [sorted(float(one.transform.to_coordinate(end)) for end in one.fit_bounds or ()) for one, _ in parts]
        low, high = np.repeat(np.reshape(ends, (-1, 2)), [size for _, size in parts], axis=0).T
        open_ended = np.full(self.values.start.size, np.inf)
        return np.concatenate([low, -open_ended]), np.concatenate([high, open_ended])

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
        values = np.asarray(x)[self.of_effects] if self.effect_coordinates else ()
        for c, value in zip(self.effect_coordinates, values, strict=True):
            number = float(c.declared.from_coordinate(value))
            if c.entry is None:
                tables[c.effect][c.key] = number
            else:
                tables[c.effect][c.key][c.entry] = number
        # only differences act: without the mean over the fitted views, the other views stay as they are
        for (effect, name), views in self.zero_sums.items():
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
        x = np.asarray(x)
        return np.concatenate([x[: other.learned.size], self._effect_values(self._tables), x[other.of_values]])

    def _with(self, x: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        found = nodes.copy()
        found[self._learned] = x[: self.learned.size]
        return found

    def _effect_coordinates(self) -> list[EffectCoordinate]:
        found = []
        contained, parameters = held_by(self.scene.effects), self.scene.parameters
        for name, table in self.scene.effects.items():
            for index, declared in enumerate(get(name).parameters if name not in contained else ()):
                stated = table.get(declared.name)
                entries: Sequence[tuple[int, str]] = [(index, "")]
                if declared.per_view:
                    entries = [(index, f"[{v.name}]") for v in self.chosen if v.name in (stated or {})]
                elif declared.per_material:
                    all_of_them = enumerate(self.scene.mesh.materials, index)
                    entries = [(at, f"[{m}]") for at, m in all_of_them if m in (stated or {})]
                for at, entry in entries:
                    parameter = parameters.get(f"effects.{name}.{declared.name}{entry}")
                    if parameter is not None and parameter.freed:
                        found.append(EffectCoordinate(parameter, declared, at))
        return found

    def _effect_values(self, tables: Mapping[str, Mapping[str, Any]]) -> np.ndarray:
        """The effects' part of x that stands in `tables`."""
        values = []
        for c in self.effect_coordinates:
            value = tables[c.effect][c.key]
            values.append(c.declared.to_coordinate(value if c.entry is None else value[c.entry]))
        return np.array(values, float)

    @property
    def zero_sum_means(self) -> np.ndarray:
        """Directions in x that change nothing by definition, shape (n, p): the mean of values that sum to zero."""
        rows = np.zeros((len(self.zero_sums), self.x0.size))
        for row, key in zip(rows, self.zero_sums, strict=True):
            mine = [(c.effect, c.key) == key for c in self.effect_coordinates]
            row[self.of_effects] = np.array(mine, float) / np.sqrt(sum(mine))
        return rows

    @property
    def zero_sums(self) -> dict[tuple[str, str], list[str]]:
        """The fitted views of every per-view parameter whose values sum to zero, by effect and key.

        Views are free where others hold the level: a single one moves against the views whose values are known, test
        views alone move against the train views, and train views that a table names move against those it does not.
        """
        found: dict[tuple[str, str], list[str]] = {}
        for c in self.effect_coordinates:
            if c.declared.zero_sum and c.view is not None:
                found.setdefault((c.effect, c.key), []).append(c.view)
        return {key: views for key, views in found.items() if len(views) > 1 and not self._is_held(*key)}

    def _is_held(self, effect: str, key: str) -> bool:
        """Whether train views hold the level of a per-view parameter."""
        stated, train = self._tables[effect][key], {v.name for v in self.scene.views if v.role == "train"}
        fitted = train & {view.name for view in self.chosen}
        return bool(fitted - set(stated)) if fitted else bool(train & set(stated))
