"""Build the reference of scenario files as Markdown from the JSON schema."""

import json
from collections.abc import Iterator
from typing import Any

from skyherd.datasets import Scenario

Schema = dict[str, Any]

INTRODUCTION = """\
# Scenario files

Generated from the JSON schema (`skyherd scenario schema`).

A file is TOML: a key `k` in the section `control` is written `k = 0.2` under `[control]`, or on the command
line as `--set control.k=0.2`. `skyherd scenario check FILE` checks a file.
The suffix of a name is its unit: `_s` seconds, `_m` metres, `_px` pixels, `_deg` degrees, `_sides` marker
sides.
"""

LIMITS = (
    ("minimum", "at least {:g}"),
    ("exclusiveMinimum", "above {:g}"),
    ("maximum", "at most {:g}"),
    ("exclusiveMaximum", "below {:g}"),
)
NO_LIMIT = 1e6
"""Size from which limits are omitted. Chosen: they only reject absurd values."""


def scenario_reference() -> str:
    """Return the page: the top level, then a section per table."""
    schema = Scenario.model_json_schema()
    named = {name: paths for name, paths in sections(schema)}
    parts = [INTRODUCTION, "## Top level\n", table(schema)]
    for name, paths in named.items():
        model = schema["$defs"][name]
        title = ", ".join(f"`{path}`" for path in paths)
        parts += [f"## {title} {{ #{name.lower()} }}\n", f"{model.get('description', '')}\n", table(model)]
    return "\n".join(parts)


def sections(schema: Schema) -> Iterator[tuple[str, list[str]]]:
    """Return each reachable model with the paths of its tables."""
    paths: dict[str, list[str]] = {}
    waiting = [("", schema)]
    while waiting:
        prefix, model = waiting.pop(0)
        for key, value in model["properties"].items():
            for name, suffix in references(value):
                path = f"{prefix}{key}{suffix}"
                known = name in paths
                paths.setdefault(name, []).append(path)
                if not known:
                    waiting.append((f"{path}.", schema["$defs"][name]))
    yield from paths.items()


def references(value: Schema) -> Iterator[tuple[str, str]]:
    """Yield the possible models of a value, each with `[]` for an item of a list, or with its kind."""
    if "$ref" in value:
        yield model_name(value["$ref"]), ""
    for option in value.get("anyOf", []):
        yield from references(option)
    for name, kinds in kinds_of(value).items():
        yield name, f"[kind={'|'.join(kinds)}]"
    if isinstance(value.get("items"), dict):
        yield from ((name, suffix or "[]") for name, suffix in references(value["items"]))


def kinds_of(value: Schema) -> dict[str, list[str]]:
    """Return the models of a value that are told apart by `kind`, each with its kinds."""
    kinds: dict[str, list[str]] = {}
    for kind, reference in value.get("discriminator", {}).get("mapping", {}).items():
        kinds.setdefault(model_name(reference), []).append(kind)
    return kinds


def model_name(reference: str) -> str:
    """Return the name of the model at a reference."""
    return reference.rsplit("/", 1)[-1]


def table(model: Schema) -> str:
    """Return the table of a model's keys: type, default and meaning."""
    required = model.get("required", [])
    rows = ["| key | type | default | meaning |", "|---|---|---|---|"]
    for key, value in model["properties"].items():
        left_out = "required" if key in required else default(value.get("default"))
        meaning = value.get("description", "").replace("|", "\\|")
        rows.append(f"| `{key}` | {taken(value)} | {left_out} | {meaning} |")
    return "\n".join(rows) + "\n"


def default(given: Any) -> str:
    """Return the default of a key as TOML; empty for tables, whose keys have defaults."""
    listed = given if isinstance(given, list) else [given]
    tables = any(isinstance(one, dict) for one in listed)
    return "" if given is None or given == [] or tables else f"`{json.dumps(given)}`"


def taken(value: Schema) -> str:
    """Return the type and range of a key in words."""
    if "$ref" in value:
        return f"[a table](#{model_name(value['$ref']).lower()})"
    if kinds := kinds_of(value):
        links = (f"[{', '.join(names)}](#{name.lower()})" for name, names in kinds.items())
        return f"tables of the kinds {', '.join(links)}"
    if "anyOf" in value:
        return " or ".join(
            dict.fromkeys(taken(option) for option in value["anyOf"] if option.get("type") != "null")
        )
    if "const" in value:
        return f'`"{value["const"]}"`'
    if "enum" in value:
        return ", ".join(f'`"{one}"`' for one in value["enum"])
    if "prefixItems" in value:
        kinds = [taken(item) for item in value["prefixItems"]]
        return f"{len(kinds)} of: {kinds[0]}" if len(set(kinds)) == 1 else f"[{', '.join(kinds)}]"
    if isinstance(value.get("items"), dict):
        return f"a list of: {taken(value['items'])}"
    words = {"number": "a number", "integer": "an integer", "string": "text", "boolean": "`true` or `false`"}
    kind = words.get(value.get("type", ""), value.get("type", "any value"))
    limits = [text.format(value[key]) for key, text in LIMITS if key in value and abs(value[key]) < NO_LIMIT]
    return ", ".join([kind, *limits])
