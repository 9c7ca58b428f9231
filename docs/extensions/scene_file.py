"""The tables of the scene file's reference, from the models that read the file and the effects' declarations.

    python docs/extensions/scene_file.py     # writes them into docs/reference/scene-file.md

They stand in the page between `<!-- scene tables -->` and `<!-- /scene tables -->`, `effect tables` alike. So a host
of code shows them without a build. As an extension of Sphinx this file warns where they are older than the code.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import tomlkit

from warpsar.effects.registry import get, names
from warpsar.scene.schema import scene_schema
from warpsar.world.tolerance import SHARE

if TYPE_CHECKING:
    from sphinx.application import Sphinx

    from warpsar.effects.base.effect import Effect
    from warpsar.effects.base.parameter import EffectParameter, Setting

PAGE = Path(__file__).resolve().parents[1] / "reference" / "scene-file.md"
UNITS = {"_hz": "Hz", "_deg": "deg", "per_m2": "1/m^2", "_m": "m"}
HEADER = ("| key | value | default | example | meaning |", "|---|---|---|---|---|")


def setup(app: Sphinx) -> dict[str, bool]:
    app.connect("source-read", _check)
    return {"parallel_read_safe": True}


def _check(app: Sphinx, page: str, source: list[str]) -> None:
    if filled(source[0]) != source[0]:
        from sphinx.util import logging

        logging.getLogger(__name__).warning(f"{page}: tables differ from the code: run {Path(__file__).name}")


def filled(page: str) -> str:
    """The page with the tables of this version."""
    for name, made in (("scene tables", scene_tables), ("effect tables", effect_tables)):
        first, last = f"<!-- {name} -->\n", f"<!-- /{name} -->\n"
        if first in page:
            before, _, rest = page.partition(first)
            page = f"{before}{first}\n{made()}\n{last}{rest.partition(last)[2]}"
    return page


def scene_tables() -> str:
    """Every table of the file but the effects': its purpose, then a row for each key."""
    schema = scene_schema()
    parts = []
    for name, place in schema["properties"].items():
        if name == "effects":
            continue
        title = f"[[{name}]]" if "items" in place else {"materials": "[materials.NAME]"}.get(name, f"[{name}]")
        table = place.get("items") or (place["additionalProperties"] if name == "materials" else place)
        needed = "Required." if name in schema["required"] else "Optional."
        purpose = table["description"].removeprefix(f"`{title}`: ").strip()
        rows = []
        for key, each in table["properties"].items():
            rows += (
                _inner_rows(key, each) if "properties" in each else [_row(key, each, key in table.get("required", ()))]
            )
        parts += [f"## `{title}`", "", f"{needed} {purpose[:1].upper()}{purpose[1:]}", "", *HEADER, *rows, ""]
    return "\n".join(parts)


def _inner_rows(name: str, table: dict[str, Any]) -> list[str]:
    """Rows of a table that stands at an optional key: what is required is so where the table is there."""
    required = table.get("required", ())
    return [_row(f"{name}.{key}", each, key in required) for key, each in table["properties"].items()]


def _row(key: str, field: dict[str, Any], required: bool) -> str:
    default = "required" if required else _shown(field.get("default"))
    unit = next((unit for suffix, unit in UNITS.items() if key.endswith(suffix)), "")
    examples = " or ".join(map(_shown, field["examples"]))
    return _cells(f"`{key}`", _value(field, f" [{unit}]" if unit else ""), default, examples, field["description"])


def _shown(value: Any) -> str:
    """A value as TOML writes it."""
    if value is None:
        return "none"
    if isinstance(value, dict):
        table = tomlkit.inline_table()
        table.update(value)
        return f"`{table.as_string()}`"
    if isinstance(value, list) and value and all(isinstance(each, dict) for each in value):
        return f"`[{', '.join(_shown(each).strip('`') for each in value)}]`"
    return f"`{f'{value:g}' if isinstance(value, float) and value >= 1e5 else tomlkit.item(value).as_string()}`"


def _value(field: dict[str, Any], unit: str = "") -> str:
    """What may stand at a key, from its JSON schema."""
    if "anyOf" in field:
        return ", or ".join(_value(each, unit) for each in field["anyOf"])
    if "enum" in field:
        return " or ".join(map(_shown, field["enum"]))
    match field.get("type"):
        case "array" if isinstance(field["items"], list):
            return f"\\[{'; '.join(_value(each, unit) for each in field['items'])}\\]"
        case "array":
            most = "" if "minItems" in field else "at most "
            count = f"{most}{field['maxItems']}, each a " if "maxItems" in field else ""
            return f"list of {count}{_value(field['items'], unit)}"
        case "object" if "properties" in field:
            return f"table of {' and '.join(f'`{key}`' for key in field['properties'])}"
        case "object":
            named = field.get("propertyNames", {"type": "string"})
            return f"table of {_value(named)} = {_value(field['additionalProperties'])}"
        case "string" if field.get("pattern") == SHARE:
            return 'share such as `"5 %"`'
        case "string":
            return "file name" if field.get("format") == "path" else "name"
        case "boolean":
            return "`true` or `false`"
        case "integer" | "number":
            return ("whole number" if field["type"] == "integer" else "number") + _bounds(field) + unit
    raise ValueError(f"no words for {field}")


def _bounds(field: dict[str, Any]) -> str:
    if "minimum" in field and "maximum" in field:
        return f" from {_number(field['minimum'])} to {_number(field['maximum'])}"
    words = {"exclusiveMinimum": "above", "minimum": "from", "exclusiveMaximum": "and below", "maximum": "up to"}
    return "".join(f" {word} {_number(field[key])}" for key, word in words.items() if key in field)


def _number(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:g}"


def effect_tables() -> str:
    """Every effect that the registry knows: what it is, then a row for each parameter and setting."""
    parts = []
    for name in names():
        effect = get(name)
        rows = [_parameter(effect, each) for each in effect.parameters]
        rows += [_setting(effect, each) for each in effect.settings]
        about = f"{effect.summary[:1].upper()}{effect.summary[1:]}. Its physics: [{name}](../effects.md#{name})."
        parts += [f"### `[effects.{name}]`", "", about, "", *HEADER, *rows, ""]
    return "\n".join(parts)


def _parameter(effect: Effect, parameter: EffectParameter) -> str:
    unit = "" if parameter.unit == "1" else f" [{parameter.unit}]"
    value = f"number from {_number(parameter.low)} to {_number(parameter.high)}{unit}"
    if parameter.keyed_by:
        value = f"table of {parameter.keyed_by} name = {value}"
    default = f"`{_number(parameter.default)}`" + (" (neutral)" if parameter.default == parameter.neutral else "")
    example = effect.example.get(parameter.name, parameter.start or parameter.span)
    return _cells(f"`{parameter.name}`", value, default, _shown(example), parameter.description)


def _setting(effect: Effect, setting: Setting) -> str:
    value = f"table of view name = {setting.allowed}" if setting.per_view else setting.allowed
    example = effect.example.get(setting.name, setting.default)
    return _cells(f"`{setting.name}`", value, _shown(setting.default or None), _shown(example), setting.description)


def _cells(*cells: str) -> str:
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


if __name__ == "__main__":
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8")), encoding="utf-8", newline="\n")
