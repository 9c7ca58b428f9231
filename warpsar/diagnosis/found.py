"""What a diagnosis is asked for and what it found: options, candidates, turns, verdict."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from warpsar.compare.observation import Observation
from warpsar.diagnosis.geometry.registry import changes
from warpsar.diagnosis.models.carried import Carried
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.judge import Judge
from warpsar.diagnosis.models.left_out import ViewsLeftOut
from warpsar.diagnosis.models.names import kind_of
from warpsar.diagnosis.models.refit import Fitted
from warpsar.diagnosis.scores.score import NOT_TESTABLE
from warpsar.effects.base.signature import Signature
from warpsar.effects.registry import names
from warpsar.errors import InputError, refuse_number
from warpsar.scene.scene import Scene
from warpsar.simulation.sampling import Density
from warpsar.speckle.facts import SpeckleFact
from warpsar.speckle.scan import Spot


@dataclass(frozen=True)
class DiagnoseOptions:
    """How to decide.

    `family_error`: chance of naming anything, or calling the rest unexplained, where nothing is missing. `draws`:
    most draws of speckle that calibrate a turn's scores. `refits`: how many of the likeliest candidates get a full fit.
    `starts`: further starts of every fit. `most_effects`: how many may be added; by default as many as there are.
    `bodies`: whether bodies may be moved, left out or proposed; each takes renders of the whole scene, so a hundred of
    them take hours. `time_limit_s`: when after the start the search ends with what it has found; None for no limit.
    Raises InputError where the draws are too few for the error rate.
    """

    family_error: float = 0.01
    draws: int = 1000
    refits: int = 4
    starts: int = 2
    most_effects: int = field(default_factory=lambda: len(names()))
    seed: int = 0
    bodies: bool = True
    time_limit_s: float | None = None

    def __post_init__(self) -> None:
        for name in ("draws", "refits", "starts", "most_effects", "seed"):
            refuse_number(getattr(self, name), f"--{name.replace('_', '-')}", whole=True)
        refuse_number(self.family_error, "--family-error")
        if self.time_limit_s is not None:
            refuse_number(self.time_limit_s, "--time-limit")
        if not 0.0 < self.family_error < 1.0:
            raise InputError(f"--family-error: found {self.family_error}; allowed is between 0 and 1")
        if self.draws * self.family_error < 4:
            raise InputError(
                f"--draws: found {self.draws}; a family error rate of {self.family_error} needs "
                f"{int(np.ceil(4 / self.family_error))} draws or more"
            )
        if self.time_limit_s is not None and not self.time_limit_s > 0.0:
            raise InputError(f"--time-limit: found {self.time_limit_s / 60.0:g} minutes; allowed is more than 0")


@dataclass
class Confirmed:
    """What was asked of one added effect beside all others, and answered.

    `gain`: 2 ln L over the best model without it, for `size` parameters. `left_out`, `carried`, `signature`: as
    `Candidate` has them; None where it was not asked. `refused`: why it was taken back; empty where it holds.
    """

    effect: str
    gain: float
    size: int
    left_out: ViewsLeftOut | None = None
    carried: Carried | None = None
    signature: Signature | None = None
    refused: str = ""
    notes: list[str] = field(default_factory=list)


@dataclass
class Candidate:
    """What one effect, or one change of geometry, scored in one turn; `effect` is its name.

    Of one that was added, the gain and what follows are those beside all others at the end (`answered`).

    `eta`: share of its template that the surface cannot imitate; from `least` on it is found by itself.
    `minus_log_p`: -ln p of its largest score, calibrated by the bootstrap. `p_value`: that of the family.
    """

    effect: str
    testability: str  # "testable", "not_testable" or "absent": the scene has no place for it
    eta: float = float("nan")
    least: float = NOT_TESTABLE
    statistic: float = float("nan")
    minus_log_p: float = 0.0
    p_value: float = 1.0
    resembles: list[str] = field(default_factory=list)
    refit_gain: float | None = None  # 2 ln L over the model without it
    refit_size: int | None = None
    left_out: ViewsLeftOut | None = None
    carried: Carried | None = None  # how much of its gain the surface carries from view to view
    signature: Signature | None = None  # what its own test says
    refused: str = ""  # why it was not added, where it was fitted or could not be
    again_at: float | None = None  # log-likelihood of all usable pixels, below which it cannot explain enough
    note: str = ""
    table: dict[str, Any] | None = None  # the effect's table as its fit in the turn left it

    @property
    def shared(self) -> bool:
        """Whether the surface could be the cause."""
        return self.carried is not None and self.carried.by_surface(self.effect)

    def remark(self, text: str) -> None:
        """Add to the note."""
        self.note += f"{'; ' if self.note else ''}{text}"

    def answered(self, one: Confirmed) -> None:
        """Take over what was found of the effect beside all others."""
        self.refit_gain, self.refit_size = one.gain, one.size
        self.left_out, self.carried, self.signature = one.left_out, one.carried, one.signature
        self.refused = one.refused
        for note in one.notes:
            self.remark(note)


@dataclass(frozen=True)
class DarkScan:
    """The strongest row, column or window of dark pixels, about the model of a turn.

    `minus_log_p`: -ln p under speckle at the declared looks. `rows`, `cols`: the first pixel, and the one after the
    last. `measured` and `modelled` [beta0]: means over its dark pixels, of which `pixels` are judged. `possible`:
    whether the model puts any power there.
    """

    minus_log_p: float
    z: float
    observation: int
    kind: str
    rows: tuple[int, int]
    cols: tuple[int, int]
    pixels: int
    measured: float
    modelled: float
    possible: bool

    @classmethod
    def of(cls, content: Mapping[str, Any]) -> DarkScan:
        """From its fields in JSON's types."""
        return cls(**{**content, "rows": tuple(content["rows"]), "cols": tuple(content["cols"])})


@dataclass
class Turn:
    """One turn: what was tested, what was added on trial (None: nothing), and what was dropped of earlier turns'
    effects. `dark`: what the scan of dark pixels found; None where there are too few. `draws`: how many
    calibrated the scores."""

    candidates: list[Candidate]
    added: str | None
    spot: Spot
    scan_minus_log_p: float
    p_scan: float
    threshold: float
    base: Fitted
    fitted: Fitted | None = None
    dropped: list[str] = field(default_factory=list)
    dark: DarkScan | None = None
    draws: int = 0

    @property
    def alarms(self) -> bool:
        """Whether the scan finds something, in the light or in dark pixels."""
        in_the_dark = 0.0 if self.dark is None else self.dark.minus_log_p
        return max(self.scan_minus_log_p, in_the_dark) > self.threshold


# Standard deviations beyond which a rival would not leave what was measured, were it the cause: 1 %, one-sided.
REFUSES = 2.33


@dataclass(frozen=True)
class EffectRival:
    """`other` in the place of `effect`: `gain` is 2 ln L of `effect` over it.

    `distance`: sum of L (ln mu - ln mu')^2 over the pixels. The gain is that on average were `effect` the cause, and
    minus that were `other`. `z`: how many standard deviations the gain lies from what it would be were `other` the
    cause (Cox, Proc. 4th Berkeley Symposium 1, 1961, for models whose parameters are known better than they differ).
    `margin`: the gain less the price of further parameters, by which one of the two is named, and its standard `error`
    (Vuong, Econometrica 57, 1989).
    """

    effect: str
    other: str
    scene: Scene  # with `other`, fitted
    gain: float
    distance: float
    z: float
    margin: float
    error: float

    @property
    def undecided(self) -> bool:
        """Whether `other` could be the cause as well, or other speckle would have had it named."""
        return self.z < REFUSES or self.margin < 2.0 * self.error


@dataclass
class Diagnosis:
    """`turns` in their order: the last one added nothing, unless the limit was reached. `declared` is the model of the
    scene file, fitted. `final` is the one with every added effect that holds. Both have the looks and texture that
    `speckle`, found about the declared model, names. `rivals`: other effects in the place of these. `objects`: what
    became of those that were changed, by name; `sensor`: the same of angles and spacings. `withdrawn`: effects that
    held on the train views, but that test views speak against. `not_asked`: what a limit of time left out, in
    words; empty where the search came to its end. `on_trial`: what was added and, for want of time, never asked beside
    the others. `of_test_views`: what single test views hold by themselves, which no train view can tell. `judge`
    compares models with all images."""

    scene: Scene
    declared: Fitted
    final: Fitted
    turns: list[Turn]
    unexplained: bool
    density: Density
    setup: FitSetup
    judge: Judge
    speckle: SpeckleFact
    rivals: list[EffectRival] = field(default_factory=list)
    withdrawn: list[str] = field(default_factory=list)
    objects: dict[str, dict[str, Any]] = field(default_factory=dict)
    sensor: dict[str, dict[str, Any]] = field(default_factory=dict)
    not_asked: list[str] = field(default_factory=list)
    on_trial: list[str] = field(default_factory=list)
    of_test_views: list[str] = field(default_factory=list)

    def __repr__(self) -> str:
        return f"<Diagnosis: {len(self.turns)} turns, held {', '.join(self.held) or 'nothing'}>"

    @property
    def observations(self) -> list[Observation]:
        """What the last turn scanned, in the order that its spot counts them."""
        return self.turns[-1].base.problem.observations

    @property
    def held(self) -> list[str]:
        """What was added and holds, in order: effects, and changes of geometry with their objects."""
        final = {*self.final.scene.effects, *changes(self.scene, self.final.scene)}
        added = dict.fromkeys(turn.added for turn in self.turns if turn.added in final)
        return [*added, *self.of_test_views]

    @property
    def verdict(self) -> list[str]:
        """The plain names of what the final model has, each once."""
        return list(dict.fromkeys(kind_of(name) for name in self.held))

    def signed(self, name: str) -> bool:
        """Whether an effect's own test confirms it, beside all others."""
        turns = [turn for turn in self.turns if turn.added == name]
        own = [c.signature for c in (turns[-1].candidates if turns else []) if c.effect == name]
        return any(one is not None and one.outcome == "confirmed" for one in own)
