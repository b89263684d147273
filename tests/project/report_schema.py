"""What a run would report of an adjustment made now, against the schema of its report."""

from __future__ import annotations

import json
from importlib import resources
from typing import Any

import jsonschema

from stereomate.project.run_record import orientation_part


def require_reportable(record: dict[str, Any]) -> None:
    """That report.json is valid with this adjustment.json behind it."""
    schema = json.loads(resources.files("stereomate.report").joinpath("report.schema.json").read_text())
    jsonschema.validate(orientation_part(record), schema["properties"]["orientation"])
