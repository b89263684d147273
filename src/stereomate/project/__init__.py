"""Project file, workspace, pipeline of stages, resume."""

from stereomate.project.loader import load
from stereomate.project.model import Project

__all__ = ["Project", "load"]
