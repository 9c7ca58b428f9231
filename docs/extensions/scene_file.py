"""Sphinx extension: the scene file's reference, from the models that read the file and the effects' declarations.

A page asks for it with the comments `<!-- scene tables -->` and `<!-- effect tables -->`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from warpsar.effects.registry import get, names
from warpsar.scene.file import SceneFile
from warpsar.world.tables import allowed_values

if TYPE_CHECKING:
    from sphinx.application import Sphinx

    from warpsar.effects.base.parameter import Parameter, Setting

UNITS = {"_hz": "Hz", "_deg": "deg", "_m": "m"}
HEADER = ("| key | value | default | meaning |", "|---|---|---|---|")


def setup(app: Sphinx) -> dict[str, bool]:
    app.connect("source-read", _fill)
    return {"parallel_read_safe": True}


def _fill(app: Sphinx, page: str, source: list[str]) -> None:
    for mark, made in (("<!-- scene tables -->", scene_tables), ("<!-- effect tables -->", effect_tables)):
        if mark in source[0]:
            source[0] = source[0].replace(mark, made())


def scene_tables() -> str:
    """Every table of the file but the effects': its purpose, then a row for each key."""
    schema = SceneFile.model_json_schema(by_alias=True)
    parts = []
    for name, place in schema["properties"].items():
        if name == "effects":
            continue
        model = schema["$defs"][_reference(place).rpartition("/")[2]]
        title = f"[[{name}]]" if place.get("type") == "array" else f"[{name}]"
        title = f"[{name}.NAME]" if name == "materials" else title
        needed = "Required." if name in schema["required"] else "Optional."
        purpose = model.get("description", "").removeprefix(f"`{title}`: ").strip()
        rows = []
        for key, each in model["properties"].items():
            inner = _inner(schema, each)
            rows += [_row(key, each, key in model.get("required", ()))] if inner is None else _inner_rows(key, inner)
        parts += [f"## `{title}`", "", f"{needed} {purpose[:1].upper()}{purpose[1:]}", "", *HEADER, *rows, ""]
    return "\n".join(parts)


def _inner(schema: dict[str, Any], field: dict[str, Any]) -> dict[str, Any] | None:
    """The model of a key that is a table itself."""
    named = [each["$ref"] for each in field.get("anyOf", ()) if "$ref" in each]
    return schema["$defs"][named[0].rpartition("/")[2]] if named else None


def _inner_rows(name: str, model: dict[str, Any]) -> list[str]:
    """Rows of a table that stands at an optional key: what is required is so where the table is there."""
    required = model.get("required", ())
    return [_row(f"{name}.{key}", each, key in required) for key, each in model["properties"].items()]


def _reference(place: dict[str, Any]) -> str:
    """Where the schema has the model of a table, of a list of tables or of tables by name."""
    found = place.get("$ref") or (place.get("items") or place["additionalProperties"])["$ref"]
    return str(found)


def _row(key: str, field: dict[str, Any], required: bool) -> str:
    default = "required" if required else _shown(field.get("default"))
    unit = next((unit for suffix, unit in UNITS.items() if key.endswith(suffix)), "")
    value = _value(field) or allowed_values(key)  # a surface value has a check of its own, which has no schema
    return _cells(f"`{key}`", f"{value} [{unit}]" if unit else value, default, field.get("description", ""))


def _shown(default: Any) -> str:
    if default is None:
        return "none"
    text = repr(default).replace("'", '"')
    return f"`{text.lower() if isinstance(default, bool) else text}`"


def _value(field: dict[str, Any]) -> str:
    """What may stand at a key, from its JSON schema."""
    if "anyOf" in field:
        return " or ".join(_value(each) for each in field["anyOf"] if each.get("type") != "null")
    if "enum" in field:
        *first, last = (f'`"{choice}"`' for choice in field["enum"])
        return f"{', '.join(first)} or {last}"
    match field.get("type"):
        case "array" if "prefixItems" in field:
            each = {_value(item) for item in field["prefixItems"]}
            return f"list of {len(field['prefixItems'])}, each a {' or '.join(sorted(each))}"
        case "array":
            return f"list of {_value(field['items'])}"
        case "object":
            return f"table of {_value(field['propertyNames'])} = {_value(field['additionalProperties'])}"
        case "string":
            return "file name" if field.get("format") == "path" else "text"
        case "boolean":
            return "`true` or `false`"
        case "integer" | "number":
            return ("whole number" if field["type"] == "integer" else "number") + _bounds(field)
    return ""


def _bounds(field: dict[str, Any]) -> str:
    if "minimum" in field and "maximum" in field:
        return f" from {_number(field['minimum'])} to {_number(field['maximum'])}"
    words = {"exclusiveMinimum": "above", "minimum": "from", "exclusiveMaximum": "below", "maximum": "up to"}
    return "".join(f", {word} {_number(field[key])}" for key, word in words.items() if key in field)


def _number(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:g}"


def effect_tables() -> str:
    """Every effect that the registry knows: what it is, then a row for each parameter and setting."""
    parts = []
    for name in names():
        effect = get(name)
        rows = [*map(_parameter, effect.parameters), *map(_setting, effect.settings)]
        about = f"{effect.summary[:1].upper()}{effect.summary[1:]}. Its physics: [{name}](../effects.md#{name})."
        parts += [f"### `[effects.{name}]`", "", about, "", *HEADER, *rows, ""]
    return "\n".join(parts)


def _parameter(parameter: Parameter) -> str:
    unit = "" if parameter.unit == "1" else f" [{parameter.unit}]"
    value = f"number from {_number(parameter.low)} to {_number(parameter.high)}{unit}"
    if parameter.per_view:
        value = f"table of view name = {value}"
    default = _number(parameter.default) + ("" if math.isnan(parameter.neutral) else " (neutral)")
    return _cells(f"`{parameter.name}`", value, default, getattr(parameter, "description", ""))


def _setting(setting: Setting) -> str:
    value = f"table of view name = {setting.allowed}" if setting.per_view else setting.allowed
    return _cells(f"`{setting.name}`", value, _shown(setting.default or None), getattr(setting, "description", ""))


def _cells(*cells: str) -> str:
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"
