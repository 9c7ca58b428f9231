"""`warpsar schema`: the JSON schema of a scene file, from the models that read it and the effects' declarations."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, get_args

from pydantic.json_schema import GenerateJsonSchema

from warpsar.effects.base.parameter import EffectParameter, Setting
from warpsar.effects.registry import get, names
from warpsar.io.images import replacing
from warpsar.models.base.model import SurfaceParameter
from warpsar.models.base.parameters import OF_SURFACES
from warpsar.models.registry import get as get_model
from warpsar.models.registry import names as model_names
from warpsar.models.registry import own_parameters
from warpsar.scene.file import SceneFile
from warpsar.world import tolerance
from warpsar.world.library.surfaces import SURFACES
from warpsar.world.objects.table import KEYS
from warpsar.world.tables import LARGEST_OF_LAYER, SURFACE_KEYS, Polarization, SpacingKey, ViewKey

DRAFT = "http://json-schema.org/draft-07/schema#"  # what editors' TOML plug-ins know
_NAME = {"type": "string", "minLength": 1}
_FILE = {**_NAME, "format": "path"}
_Json = dict[str, Any]


_ROUGH = ("eps_r", "rms_height_m", "correlation_length_m")
_SURFACES: list[_Json] = [  # of the library, rough, smooth, or a conductor
    {"required": ["library"]},
    {"required": list(_ROUGH)},
    {"required": ["eps_r", "rms_height_m"], "properties": {"rms_height_m": {"const": 0}}},
    {"required": ["layers"]},
    {"required": ["conductor"], "properties": {"conductor": {"const": True}}},
]


def _of_models() -> list[_Json]:
    """What a material states with a model of which the tables above ask too much."""
    found: dict[tuple[str, ...], list[str]] = {}
    for one in map(get_model, model_names()):
        needed = ("sigma0",) if one.from_table else tuple(key for key in one.keys if key in _ROUGH)
        if set(needed) < set(_ROUGH) or one.from_table:
            found.setdefault(("model", *needed), []).append(one.name)
    return [
        {
            "required": list(keys),
            "properties": {"model": {"const": names[0]} if len(names) == 1 else {"enum": names}},
        }
        for keys, names in found.items()
    ]


class _Generator(GenerateJsonSchema):
    """A surface value has a check of its own, of which pydantic (to 2.9) can make no schema: `_surface` does."""

    def handle_invalid_for_json_schema(self, schema: Any, error_info: str) -> _Json:
        return {}


def run(path: Path | str | None = None) -> str:
    """`warpsar schema`: the schema as text, written to `path` unless that is None."""
    text = json.dumps(scene_schema(), indent=2, ensure_ascii=False) + "\n"
    if path is not None:
        with replacing(path) as temporary:
            temporary.write_text(text, encoding="utf-8", newline="\n")
    return text


def scene_schema() -> _Json:
    """JSON schema (draft 7) of a scene file. It has no references.

    It holds each key by itself, and of rules between keys those that choose one of several. It does not look into the
    files that a scene names.
    """
    made = SceneFile.model_json_schema(by_alias=True, schema_generator=_Generator)
    scene = _plain(made, made.pop("$defs"))
    tables = scene["properties"]
    for one in (*OF_SURFACES, *own_parameters().values()):
        tables["materials"]["additionalProperties"]["properties"][one.key].update(_surface(one))
    layer = tables["materials"]["additionalProperties"]["properties"]["layers"]["items"]["properties"]
    first: _Json = {"type": "number", "exclusiveMinimum": 0.0, "maximum": LARGEST_OF_LAYER}
    second: _Json = {"type": "number", "minimum": -LARGEST_OF_LAYER, "maximum": 0.0}
    pair: _Json = {"type": "array", "items": [first, second], "minItems": 2, "maxItems": 2}
    for key in ("eps_r", "mu_r"):
        layer[key].update(anyOf=[first, pair])
    known = tables["materials"]["additionalProperties"]["properties"]["tolerance"]
    known.update(additionalProperties=_tolerance({"type": "number"}), propertyNames={"enum": list(SURFACE_KEYS)})
    for table, keys in ((tables["image"], SpacingKey), (tables["views"]["items"], ViewKey), (tables["radar"], ViewKey)):
        known = table["properties"]["tolerance"]
        known.update(additionalProperties=_tolerance({"type": "number"}), propertyNames={"enum": list(get_args(keys))})
    tables["materials"]["additionalProperties"]["anyOf"] = [*_SURFACES, *_of_models()]
    tables["materials"]["additionalProperties"]["properties"]["library"]["enum"] = list(SURFACES)
    view = tables["views"]["items"]
    view["oneOf"] = [{"required": [key]} for key in ("incidence_deg", "depression_deg", "grazing_deg")]
    for named in ("images", "slc"):
        view["properties"][named].update(propertyNames={"enum": list(get_args(Polarization))})
    one = tables["objects"]["items"]
    one["oneOf"] = [{"required": [key]} for key in ("mesh", "primitive", "group")]
    number: _Json = {"type": "number"}
    about = {"anyOf": [number, {"type": "array", "items": number, "minItems": 3, "maxItems": 3}]}
    known = {"additionalProperties": _tolerance(about, each=True), "propertyNames": {"enum": list(KEYS.values())}}
    one["properties"]["tolerance"].update(known)
    body = {"contains": {"anyOf": [{"required": ["mesh"]}, {"required": ["primitive"]}]}}
    scene["anyOf"] = [
        {"properties": {"scene": {"required": ["mesh"]}}},
        {"required": ["objects"], "properties": {"objects": body}},
    ]
    tables["sampling"]["not"] = {"required": ["rays_per_pixel", "rays_per_m2"]}
    about = tables["effects"]["description"]
    tables["effects"] = _table({name: _effect(name) for name in names()}, about)
    return {"$schema": DRAFT, "title": "warpsar scene file", **scene}


def _plain(node: _Json, models: dict[str, _Json]) -> _Json:
    """pydantic's schema in the words of draft 7, each table in its place; TOML has no null."""
    (reference,) = node.get("allOf", [node])  # pydantic 2.7 wraps a reference that has company
    if "$ref" in reference:
        return _plain(models[reference["$ref"].rpartition("/")[2]], models)
    node = {key: value for key, value in node.items() if key != "title"}
    if "anyOf" in node:
        kinds = [_plain(each, models) for each in node.pop("anyOf") if each.get("type") != "null"]
        node = {**(kinds[0] if len(kinds) == 1 else {"anyOf": kinds}), **node}
    if "prefixItems" in node:  # a pair or triple, mostly of one kind
        first, *others = node.pop("prefixItems")
        node["items"] = first if all(each == first for each in others) else [first, *others]
    if node.get("default", "") is None:
        del node["default"]
    if node.get("format") == "path":
        node.update(_FILE)
    for key in ("items", "additionalProperties"):
        if isinstance(node.get(key), dict):
            node[key] = _plain(node[key], models)
    if "properties" in node:
        node["properties"] = {key: _plain(each, models) for key, each in node["properties"].items()}
    return node


def _surface(one: SurfaceParameter) -> _Json:
    """What a surface value may be: a number, a pair for some keys, or the name of an image or a scalar."""
    key, (low, high) = one.key, one.limits
    least = "minimum" if one.from_low or key == "rms_height_m" else "exclusiveMinimum"
    number = {"type": "number", least: low, "maximum": high}
    second = {"eps_r": {"type": "number", "minimum": -high, "maximum": 0.0}, "correlation_length_m": number}.get(key)
    pair = {"type": "array", "items": [number, second], "minItems": 2, "maxItems": 2}
    return {"anyOf": [number, *([pair] if second else []), _NAME]}


def _effect(name: str) -> _Json:
    effect = get(name)
    keys = {each.name: _key(each, _number(each)) for each in effect.parameters}
    for each in effect.settings:
        default = {} if each.default is None else {"default": each.default}
        keys[each.name] = _key(each, {**each.schema, **default})
    some = {"type": "array", "items": {"enum": [each.name for each in effect.parameters]}, "uniqueItems": True}
    keys["fixed"] = {
        "description": "Whether a fit leaves the whole table as it is.",
        "type": "boolean",
        "default": False,
    }
    keys["learn"] = {"description": "Parameters of this table that a fit may change; all that it states.", **some}
    keys["tolerance"] = _table(
        {each.name: _tolerance(_value(each, _number(each))) for each in effect.parameters},
        "How well fitted parameters are known: one standard deviation each, in the key's unit or in percent.",
    )
    table = _table(keys, f"{effect.summary[:1].upper()}{effect.summary[1:]}.")
    if (bring := effect.needed()) is not None:
        table["anyOf"] = [{"required": [each.name]} for each in bring]
    return table


def _number(parameter: EffectParameter) -> _Json:
    """Its bounds and default; JSON has no infinity, and an infinite bound is none."""
    stated = {"minimum": parameter.low, "maximum": parameter.high, "default": parameter.default}
    return {"type": "number", **{key: value for key, value in stated.items() if math.isfinite(value)}}


def _key(declared: EffectParameter | Setting, value: _Json) -> _Json:
    """The schema of a key: of one value, or of a table of a value for each view or material."""
    unit = getattr(declared, "unit", "1")
    about = declared.description if unit == "1" else f"{declared.description.rstrip('.')} [{unit}]."
    if (keyed_by := _keyed_by(declared)) is None:
        return {"description": about, **value}
    return {"description": f"{about} A table of {keyed_by} names and values.", **_value(declared, value)}


def _value(declared: EffectParameter | Setting, value: _Json) -> _Json:
    """The schema of what stands at a key: `value`, or a table of one for each view or material."""
    if _keyed_by(declared) is None:
        return value
    value.pop("default", None)  # of a view or a material that is not named
    return {"type": "object", "additionalProperties": value}


def _keyed_by(declared: EffectParameter | Setting) -> str | None:
    """What the table at a key names; None where it is one value."""
    return declared.keyed_by if isinstance(declared, EffectParameter) else "view" if declared.per_view else None


def _tolerance(about: _Json, *, each: bool = False) -> _Json:
    """One standard deviation, a share of the value, or either with the value that is known; `each`: or three."""
    sd: list[_Json] = [{"type": "number", "exclusiveMinimum": 0.0}, {"type": "string", "pattern": tolerance.SHARE}]
    if each:
        three: _Json = {"type": "number", "minimum": 0.0}  # 0 holds an element
        some = {"contains": {"type": "number", "exclusiveMinimum": 0.0}}
        sd.append({"type": "array", "items": three, "minItems": 3, "maxItems": 3, **some})
    pinned = {"about": about, "sd": {"anyOf": sd}}
    table = {"type": "object", "properties": pinned, "required": list(pinned), "additionalProperties": False}
    return {"anyOf": [*sd, table]}


def _table(keys: dict[str, _Json], about: str) -> _Json:
    return {"type": "object", "description": about, "properties": keys, "additionalProperties": False}
