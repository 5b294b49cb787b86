"""Error messages for configuration files: where, what is wrong, what is allowed, what to do.

Pydantic finds the problems. The wording comes from the model's JSON schema. In a union of models, the value
of a key such as `kind` tells the model; Pydantic adds this tag to locations. A validator of a model raises
`InputError`, located at a key relative to the model, or at an empty key for the value itself.
"""

from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from skyherd.errors import MAX_PROBLEMS, InputError, join_errors
from skyherd.text import did_you_mean, one_of, shorten

MAX_SHOWN = 60
"""Maximum number of characters of a value or a key in a message. Chosen: a number, a name or a short list."""

MAX_LEVELS = 8
"""Maximum depth of tables in the search for a key. Chosen: scenarios have six levels."""

RENAMED_BEGINNINGS = {"least_": "min_", "smallest_": "min_", "most_": "max_", "largest_": "max_"}
"""Prefixes of keys in earlier versions, and their replacements."""

RENAMED_KEYS: Mapping[str, str] = {}
"""Other keys of earlier versions, and their present names."""

MAX_EXACT = 1e15
"""Magnitude below which 15 digits represent a bound exactly."""

Schema = dict[str, Any]
"""JSON schema, or a part of one."""

Location = tuple[int | str, ...]
"""Keys and indices that lead to a value."""

M = TypeVar("M", bound=BaseModel)


def check_tree(
    model: type[M], tree: Any, where: str, *, see: str, origins: Mapping[str, str] | None = None
) -> M:
    """Validate a tree of plain values against a model.

    Args:
        model: the model.
        tree: dictionaries, lists and plain values, as in a TOML file.
        where: the file, or its name in error messages.
        see: command that shows the allowed values.
        origins: command-line options that set values, by dotted key; see `locate`.

    Raises:
        InputError: all problems of the tree, unknown keys first.
    """
    try:
        valid = model.model_validate(tree)
    except ValidationError as error:
        raise input_error(error, model, where, see=see, origins=origins) from None
    problems = [
        InputError(locate(where, key, origins or {}), what, allowed)
        for key, what, allowed in _no_numbers(tree, _schema(model))
    ]
    if problems:
        raise join_errors(problems[:MAX_PROBLEMS], more=max(0, len(problems) - MAX_PROBLEMS))
    return valid


def input_error(
    error: ValidationError,
    model: type[BaseModel],
    where: str,
    *,
    see: str,
    origins: Mapping[str, str] | None = None,
) -> InputError:
    """Convert a validation error of Pydantic into one `InputError` with all problems, unknown keys first.

    Args:
        error: Pydantic's error.
        model: the model of the validation.
        where: the file, or its name in error messages.
        see: command that shows the allowed values.
        origins: command-line options that set values, by dotted key; see `locate`.
    """
    schema = _schema(model)
    details = error.errors(include_url=False)
    details.sort(key=_rank)
    problems = []
    for detail in details[:MAX_PROBLEMS]:
        for key, what, allowed in _problems(detail, schema):
            place = locate(where, key, origins or {}, unknown=detail["type"] == "extra_forbidden")
            problems.append(InputError(place, what, allowed or f"see `{see}`"))
    return join_errors(problems, more=max(0, len(details) - MAX_PROBLEMS))


@cache
def _schema(model: type[BaseModel]) -> Schema:
    return model.model_json_schema()


def _rank(detail: ErrorDetails) -> tuple[bool, int]:
    """Return the sort key of a problem: unknown keys first, by level; the others in their order."""
    is_unknown = detail["type"] == "extra_forbidden"
    return not is_unknown, len(detail["loc"]) if is_unknown else 0


def locate(where: str, key: str, origins: Mapping[str, str], *, unknown: bool = False) -> str:
    """Return the location in an error message: the option that set the value, or the file and the key.

    Args:
        where: the file, or its name in error messages.
        key: dotted key of the value, empty for the whole file.
        origins: settings such as `settings: control.k`, by the dotted keys that they set; `*` is any item.
        unknown: True if the key does not exist. An option whose key leads through it is then named.
    """
    parts = key.split(".")
    for given, option in reversed(list(origins.items())):
        wanted = given.split(".")
        same = all(one in ("*", other) for one, other in zip(wanted, parts, strict=False))
        if same and len(parts) >= len(wanted):
            rest = ".".join(parts[len(wanted) :])
            return f"{option}: {rest}" if rest else option
        if same and unknown:
            return option
    return f"{where}: {key}" if key else where


def shown(value: Any) -> str:
    """Return a value as text for an error message, shortened."""
    try:
        return shorten(repr(value), MAX_SHOWN)
    except ValueError:
        return "an integer of very many digits"


def expected(schema: Schema, top: Schema) -> str:
    """Return a description of the values that a schema allows.

    Args:
        schema: the schema of the value.
        top: the whole schema, in which references are resolved.
    """
    schema = _resolved(schema, top)
    if len(_options(schema)) > 1:
        options = [option for option in _options(schema) if option.get("type") != "null"]
        return ", or ".join(dict.fromkeys(expected(option, top) for option in options))
    if "const" in schema:
        return f"{schema['const']!r}"
    if "enum" in schema:
        return f"one of {', '.join(map(str, schema['enum']))}"
    match schema.get("type"):
        case "number":
            return f"a finite number{_range(schema)}"
        case "integer":
            return f"a whole number{_range(schema)}"
        case "string":
            return "a text of at least one character" if schema.get("minLength") else "a text in quotes"
        case "boolean":
            return "true or false"
        case "array":
            return _expected_list(schema, top)
        case "object":
            return "a table"
    return "any value"


def _expected_list(schema: Schema, top: Schema) -> str:
    items = [expected(item, top) for item in schema.get("prefixItems", [])]
    if items and len(set(items)) == 1:
        return f"a list of {len(items)}, each {items[0]}"
    if items:
        return f"a list of {len(items)}: {'; '.join(items)}"
    low, high = schema.get("minItems", 0), schema.get("maxItems")
    if low == high and low:
        count = f"a list of {low}"
    elif low:
        count = f"a list of at least {low}" + ("" if high is None else f" and at most {high}")
    else:
        count = "a list" if high is None else f"a list of at most {high}"
    each = expected(schema["items"], top) if isinstance(schema.get("items"), dict) else ""
    return f"{count}, each {each}" if each and each != "any value" else count


def _range(schema: Schema) -> str:
    """Return the bounds of a number, as a suffix of the word `number`."""
    low, above = schema.get("minimum"), schema.get("exclusiveMinimum")
    high, below = schema.get("maximum"), schema.get("exclusiveMaximum")
    if low is not None and high is not None:
        return f" from {_number(low)} to {_number(high)}"
    bounds = [
        f"{word} {_number(bound)}"
        for word, bound in (("at least", low), ("above", above), ("at most", high), ("below", below))
        if bound is not None
    ]
    return " " + " and ".join(bounds) if bounds else ""


def _number(bound: float) -> str:
    return f"{bound:.15g}" if abs(bound) < MAX_EXACT else str(int(bound))


def _problems(detail: ErrorDetails, top: Schema) -> Iterator[tuple[str, str, str]]:
    """Yield key, problem and allowed values for each problem in one error of Pydantic."""
    location, value = tuple(detail["loc"]), detail["input"]
    key, schema = _key(location, top), _node(location, top)
    match detail["type"]:
        case "union_tag_invalid" | "union_tag_not_found":
            tag, names = _tag(_resolved(schema, top))
            name = value.get(tag) if isinstance(value, dict) else value
            yield f"{key}.{tag}", "missing" if name is None else shown(name), one_of(str(name or ""), names)
        case "extra_forbidden":
            known = [
                name
                for option in _options(_resolved(_node(location[:-1], top), top))
                for name in _resolved(option, top).get("properties", {})
            ]
            yield key, "unknown key", _instead(str(location[-1]), known, top)
        case "missing":
            meaning = schema.get("description", "")
            yield key, "missing", "give " + expected(schema, top) + (f" ({meaning})" if meaning else "")
        case "value_error":
            yield from _own_problems(key, value, detail.get("ctx", {})["error"])
        case _:
            allowed = expected(schema, top)
            resolved = _resolved(schema, top)
            names = _names(resolved, top)
            if isinstance(value, str) and names and (meant := did_you_mean(value, names)):
                allowed = f"{meant} {allowed}"
            yield key, _what(value), allowed


def _no_numbers(tree: Any, top: Schema) -> Iterator[tuple[str, str, str]]:
    """Yield key, problem and allowed values of texts and of true or false where a number is expected.

    Pydantic takes "1.5" and true for numbers.
    """
    for location, value in _leaves(tree, ()):
        if isinstance(value, bool | str):
            schema = _resolved(_node(location, top), top)
            kinds = {_resolved(option, top).get("type") for option in _options(schema)}
            if kinds <= {"number", "integer", "null"} and kinds != {"null"}:
                yield _key(location, top), _what(value), expected(schema, top)


def _leaves(tree: Any, location: Location) -> Iterator[tuple[Location, Any]]:
    """Yield the location and value of each value in a tree that is no table and no list."""
    items: Iterable[tuple[int | str, Any]] = ()
    match tree:
        case dict():
            items = tree.items()
        case list() | tuple():
            items = enumerate(tree)
        case _:
            yield location, tree
    for key, value in items:
        yield from _leaves(value, (*location, key))


def _own_problems(key: str, value: Any, error: Exception) -> Iterator[tuple[str, str, str]]:
    """Yield key, problem and allowed values of an exception that a validator of a model raised."""
    if isinstance(error, InputError):
        for problem in error.problems:
            place = ".".join(part for part in (key, problem.where) if part)
            yield place, problem.what or _what(value), problem.allowed
        return
    what, _, allowed = str(error).partition("; ")
    yield (key, what, allowed) if allowed else (key, _what(value), what)


def _what(value: Any) -> str:
    if isinstance(value, list | tuple) and len(repr(value)) > MAX_SHOWN:
        return f"a list of {len(value)}"
    return "a table" if isinstance(value, dict) else shown(value)


def _key(location: Location, top: Schema) -> str:
    """Return a dotted key, without the marks that Pydantic adds for keys of a dictionary and tags."""
    parts = [
        str(part)
        for place, part in enumerate(location)
        if part != "[key]" and part not in _tag(_resolved(_node(location[:place], top), top))[1]
    ]
    return shorten(".".join(parts), MAX_SHOWN)


def _tag(schema: Schema) -> tuple[str, list[str]]:
    """Return the key whose value tells the model of a union, and its values; none for other schemas."""
    discriminator = schema.get("discriminator", {})
    return discriminator.get("propertyName", ""), list(discriminator.get("mapping", {}))


def _instead(name: str, known: list[str], top: Schema) -> str:
    """Return a replacement for an unknown key, where `known` are the keys at the same level."""
    if (new := renamed(name)) in known:
        return f"renamed to {new}"
    if meant := did_you_mean(name, known):
        return meant
    if place := next((path for path in _paths(top) if path.rpartition(".")[2] in (name, new)), None):
        return f"did you mean {place!r}?"
    return f"one of {', '.join(known)}"


def renamed(name: str) -> str | None:
    """Return the present name of a key of earlier versions, or None."""
    for old, new in RENAMED_BEGINNINGS.items():
        if name.startswith(old):
            return new + name.removeprefix(old)
    return RENAMED_KEYS.get(name)


def _names(schema: Schema, top: Schema) -> list[str]:
    """Return the values of an enumeration; empty for other schemas."""
    options = [_resolved(option, top) for option in _options(schema)]
    return [str(name) for option in options for name in option.get("enum", [])]


def _resolved(schema: Schema, top: Schema) -> Schema:
    """Resolve the reference of a schema, and keep the schema's own description."""
    if "$ref" not in schema:
        return schema
    found: Schema = top.get("$defs", {}).get(schema["$ref"].rsplit("/", 1)[-1], {})
    own = {key: value for key, value in schema.items() if key == "description"}
    return {**found, **own}


def _node(location: Location, top: Schema) -> Schema:
    """Return the schema of the value at a location; empty if it is not defined."""
    node = top
    for part in location:
        whole = _resolved(node, top)
        options = [whole, *(_resolved(option, top) for option in _options(whole))]
        node = next((below for below in (_below(option, part) for option in options) if below), {})
    return node


def _options(schema: Schema) -> list[Schema]:
    options: list[Schema] = schema.get("anyOf") or schema.get("oneOf") or [schema]
    return options


def _below(schema: Schema, part: int | str) -> Schema:
    """Return the schema of a list's item, of a table's key, or of a tag; empty if it is not defined."""
    found: Any = None
    if part in _tag(schema)[1]:
        found = {"$ref": schema["discriminator"]["mapping"][part]}
    elif isinstance(part, int):
        first = schema.get("prefixItems", [])
        found = first[part] if part < len(first) else schema.get("items")
    else:
        found = schema.get("properties", {}).get(part, schema.get("additionalProperties"))
    return found if isinstance(found, dict) else {}


def _paths(top: Schema) -> Iterator[str]:
    """Yield all keys of a schema as dotted paths, breadth first, with `*` for the items of lists."""
    waiting: list[tuple[str, Schema, int]] = [("", top, 0)]
    while waiting:
        prefix, node, level = waiting.pop(0)
        for option in (_resolved(option, top) for option in _options(_resolved(node, top))):
            for key, value in option.get("properties", {}).items():
                yield f"{prefix}{key}"
                if level < MAX_LEVELS:
                    waiting.append((f"{prefix}{key}.", value, level + 1))
            if isinstance(option.get("items"), dict) and level < MAX_LEVELS:
                waiting.append((f"{prefix}*.", option["items"], level + 1))
