"""Project file, workspace, pipeline of stages, resume."""
