from .base.effect import Effect as Effect
from .base.parameter import EffectParameter as EffectParameter
from .base.parameter import Setting as Setting
from .base.recorder import Recorder as Recorder
from .base.trial import Context as Context
from .base.trial import ScoreStep as ScoreStep
from .base.trial import Trial as Trial

__all__ = ["Context", "Effect", "EffectParameter", "Recorder", "ScoreStep", "Setting", "Trial"]
