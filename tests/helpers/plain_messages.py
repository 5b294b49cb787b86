"""Messages as they are in files, held against their schemas."""

from typing import Any

import orjson

from skyherd.recording.json_codec import to_json


def assert_valid(value: Any, schema: dict[str, Any], where: str = "") -> None:
    """Check that a value has exactly its schema's properties, each of the right type."""
    types = {"object": dict, "array": list, "string": str, "integer": int, "number": (int, float)}
    if schema["type"] == "boolean":
        assert isinstance(value, bool), where
        return
    assert isinstance(value, types[schema["type"]]) and not isinstance(value, bool), where
    for item in value if schema["type"] == "array" else ():
        assert_valid(item, schema["items"], f"{where}[]")
    if schema["type"] == "object":
        assert value.keys() == schema["properties"].keys() == set(schema["required"]), where
        for name, content in schema["properties"].items():
            assert_valid(value[name], content, f"{where}.{name}")


def plain(message: dict[str, Any]) -> dict[str, Any]:
    """Return a message as it is read from a file."""
    return orjson.loads(to_json(message))
