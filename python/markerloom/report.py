"""Reports as JSON: what was read, what was asked, what came out; timings in a part of their own."""

from __future__ import annotations

import hashlib
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from markerloom.formats.files import write_text


def of_run(inputs: list[str | Path], options: dict[str, Any], result: dict[str, Any]) -> dict[str, Any]:
    """The report of one verb: version, inputs with their hashes, options, and the verb's own result."""
    from markerloom import __version__

    described = [{"name": Path(p).name, "sha256": hashlib.sha256(Path(p).read_bytes()).hexdigest()} for p in inputs]
    head = {"markerloom_version": __version__, "inputs": described, "options": options}
    return {**head, "frames": 0, "warnings": [], **result}


def save(report: dict[str, Any], path: str | Path) -> None:
    """Write a report; numbers that are not finite become null."""
    write_text(path, json.dumps(_plain(report), indent=2, ensure_ascii=False) + "\n")


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
