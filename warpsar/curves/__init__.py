"""How well does a complex model explain measured curves of radar cross-section, and what does it lack?

| file | what it holds |
|---|---|
| `likelihood.py` | the density of measured power about a complex amplitude (Rice) |
| `noise.py` | background and multiplicative error, fitted or known from repeated measurements |
| `angles.py` | how many angles are independent |
| `sectors.py` | from where an aperture is seen, by geometry |
| `observed.py` | a measured curve beside the terms of its model |
| `observe.py` | the curves of a scene, and the engine's amplitudes for them, term by term, kept on disk |
| `rivals.py` | what needs no physics: a constant level, a smooth curve |
| `metrics.py` | mean abs(dB) and correlation |
| `search.py` | which terms the train curves pay for, and whether left-out curves confirm them |
| `materials.py` | whether curves show another material than a part is declared to have |
| `shape.py` | parameters by likelihood, with intervals |

`compare/curve.py` holds a measured curve beside its model; `learning/curves.py` and `diagnosis/curves.py` ask it.
"""
