"""TypeScript types of the messages, from their JSON Schemas: what ``web/src/wire.ts`` must hold."""

from __future__ import annotations

import json
from typing import Any

from pydantic.json_schema import models_json_schema

from markerloom.studio.messages import MESSAGES

HEAD = """// Generated from python/markerloom/studio/messages.py by `python -m markerloom.studio.wire`: do not edit.
"""


def typescript() -> str:
    """All messages as TypeScript."""
    _, schema = models_json_schema([(m, "serialization") for m in MESSAGES], ref_template="{model}")
    parts = [HEAD]
    for name, model in sorted(schema["$defs"].items()):
        said = "\n".join(f" * {line}".rstrip() for line in model.get("description", "").splitlines())
        parts.append(f"/**\n{said}\n */\nexport interface {name} {{\n{_fields(model)}}}\n")
    return "\n".join(parts)


def _fields(model: dict[str, Any]) -> str:
    required = set(model.get("required", []))
    lines = []
    for name, field in model.get("properties", {}).items():
        optional = "" if name in required or "const" in field else "?"
        lines.append(f"  {name}{optional}: {_type(field)};\n")
    return "".join(lines)


def _type(schema: dict[str, Any]) -> str:
    if "$ref" in schema:
        return str(schema["$ref"])
    if "const" in schema:
        return json.dumps(schema["const"])
    if "enum" in schema:
        return " | ".join(json.dumps(v) for v in schema["enum"])
    for choice in ("anyOf", "oneOf"):
        if choice in schema:
            return " | ".join(_type(s) for s in schema[choice])
    if schema.get("type") == "array":
        if "prefixItems" in schema:
            return f"[{', '.join(_type(s) for s in schema['prefixItems'])}]"
        inner = _type(schema["items"])
        return f"({inner})[]" if " | " in inner else f"{inner}[]"
    if schema.get("type") == "object":
        return f"Record<string, {_type(schema['additionalProperties'])}>"
    return {"integer": "number", "number": "number", "string": "string", "boolean": "boolean", "null": "null"}[
        schema["type"]
    ]


if __name__ == "__main__":
    print(typescript(), end="")
