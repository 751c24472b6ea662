"""A workspace that cameras watch from all sides: coloured balls on known paths, with the truth."""

from calichrome.synthetic.workspace.recording import write_workspace, write_workspace_recording
from calichrome.synthetic.workspace.render import WorkspaceRenderer
from calichrome.synthetic.workspace.scene import Ball, Box, HarmonicPath, Workspace
from calichrome.synthetic.workspace.setup import large_board, workspace_scene
from calichrome.synthetic.workspace.truth import (
    BallTruth,
    WorkspaceTruth,
    read_workspace_truth,
    workspace_truth,
    write_workspace_truth,
)

__all__ = [
    "Ball",
    "BallTruth",
    "Box",
    "HarmonicPath",
    "Workspace",
    "WorkspaceRenderer",
    "WorkspaceTruth",
    "large_board",
    "read_workspace_truth",
    "workspace_scene",
    "workspace_truth",
    "write_workspace",
    "write_workspace_recording",
    "write_workspace_truth",
]
