"""Values that stand in arrays on the device as a part of x: tables of sigma0, and the weights of learned terms.

They are sought in coordinates z, of which the prior expects a standard normal distribution: then all have one scale.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import warp as wp

from warpsar.parameters.parameter import Parameter
from warpsar.surface.stage import Stage
from warpsar.world.models import TABLE

STEP = 1.0 / 30.0  # of what is expected of a value, up and down: 0.1 dB of a table, right to 1e-4 of a derivative


@dataclass(frozen=True)
class DeviceBlock:
    """Values of a material by channel, (channels, n), in its rows of a device array, where each channel fills all its
    `columns`.

    Before any image they are `start` + z `unit`^T, with z of a standard normal distribution; `unit` is (n, n). `key`
    names the array: `TABLE` for that of tables [dB], `TERM` for that of learned terms.
    """

    material: str
    key: str
    channels: Sequence[str]
    columns: list[list[int]]
    start: np.ndarray
    unit: np.ndarray

    @classmethod
    def of(cls, parameters: Sequence[Parameter], columns: list[list[int]]) -> DeviceBlock:
        """Of a material's parameters in the tree, one for each channel, with one prior."""
        first, channels = parameters[0], [str(one.entry) for one in parameters]
        assert first.prior_root is not None
        start = np.stack([one.value for one in parameters])
        return cls(first.owner, first.key, channels, columns, start, first.prior_root())

    def array(self, stage: Stage) -> wp.array:
        """The array that the values stand in."""
        return self._arrays(stage)[0]

    def rows(self, stage: Stage) -> slice:
        """The material's rows of the array."""
        first, count = self._arrays(stage)[1].numpy()[stage.surface.materials.index(self.material)].tolist()
        return slice(first, first + count)

    def _arrays(self, stage: Stage) -> tuple[wp.array, wp.array]:
        """The values' array, and of each material its first row and how many it has."""
        if self.key == TABLE:
            assert stage.tables is not None
            return stage.tables.sigma0_db, stage.tables.rows
        assert stage.terms is not None
        return stage.terms.weights, stage.terms.first

    def values(self, z: np.ndarray) -> np.ndarray:
        """The values at z, (channels, n)."""
        return np.asarray(self.start + z.reshape(self.start.shape) @ self.unit.T)

    def gradient(self, stage: Stage) -> np.ndarray:
        """The gradient to the values, (channels, n), as the stage's array has it."""
        own = self.array(stage).grad.numpy()[self.rows(stage)].astype(float)
        return np.stack([own[:, column].sum(axis=1) for column in self.columns])

    def sd(self, covariance: np.ndarray) -> np.ndarray:
        """Standard deviations of the values, (channels, n), from the covariance of z, (channels n, channels n)."""
        own = np.kron(np.eye(len(self.start)), self.unit)
        return np.sqrt(np.diag(own @ covariance @ own.T)).reshape(self.start.shape)

    def put(self, stage: Stage, values: np.ndarray) -> None:
        """Write values, (channels, n), into the stage's array, whose other elements stay."""
        everywhere, rows = self.array(stage).numpy().copy(), self.rows(stage)
        for own, column in zip(values, self.columns, strict=True):
            everywhere[rows, column] = own[:, None]
        self.array(stage).assign(everywhere)


@dataclass(frozen=True)
class DeviceValues:
    """The blocks of a fit, one after the other in z, which begins at `start`, shape (n,)."""

    blocks: tuple[DeviceBlock, ...] = ()
    start: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def of(cls, blocks: Sequence[DeviceBlock]) -> DeviceValues:
        """With z at 0, where the prior expects it."""
        return cls(tuple(blocks), np.zeros(sum(block.start.size for block in blocks)))

    @property
    def labels(self) -> list[str]:
        """A name for every element of z: material.key, with the channel and the number of the value."""
        return [
            f"{block.material}.{block.key}[{channel} {number}]"
            for block in self.blocks
            for channel in block.channels
            for number in range(block.start.shape[1])
        ]

    @property
    def parts(self) -> Iterator[tuple[DeviceBlock, slice]]:
        """Each block, with its part of z."""
        first = 0
        for block in self.blocks:
            yield block, slice(first, first + block.start.size)
            first += block.start.size

    def on(self, stage: Stage) -> Stage:
        """The stage with arrays of its own for the blocks' values, which take a gradient."""
        keys = {block.key for block in self.blocks}
        if TABLE in keys and stage.tables is not None:
            stage = replace(stage, tables=stage.tables.copied())
        if keys - {TABLE} and stage.terms is not None:
            stage = replace(stage, terms=stage.terms.copied())
        return stage

    def put(self, stage: Stage, z: np.ndarray) -> None:
        """Write the values at z into the stage's arrays."""
        for block, part in self.parts:
            block.put(stage, block.values(z[part]))

    def slope(self, stage: Stage) -> np.ndarray:
        """The gradient to z, shape (n,), from those of the stage's arrays."""
        found = [(block.gradient(stage) @ block.unit).ravel() for block in self.blocks]
        return np.concatenate([np.zeros(0), *found])
