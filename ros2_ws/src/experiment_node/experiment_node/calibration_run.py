"""A calibration in progress."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from experiment_node.active_goal import ActiveGoal
from experiment_node.experiments import Experiment
from experiment_node.running_step import RunningStep
from fringedic_msgs.action import CalibrateDistortion, CalibrateRig


@dataclass
class CalibrationRun:
    """One calibration in progress.

    Attributes
    ----------
    goal
        The active goal.
    result
        Result of the action, filled in step by step; its class names the error codes.
    feedback
        Latest feedback of the action.
    experiment
        Experiment whose steps are the planes.
    folder
        Folder of the files.
    """

    goal: ActiveGoal
    result: CalibrateDistortion.Result | CalibrateRig.Result
    feedback: CalibrateDistortion.Feedback | CalibrateRig.Feedback
    experiment: Experiment
    folder: Path

    def report(self, words: str) -> None:
        """Publish what happens now."""
        self.feedback.words, self.feedback.frame, self.feedback.frames = words, 0, 0
        self.goal.goal.publish_feedback(self.feedback)

    def report_frames(self, _stage: str, step: RunningStep) -> None:
        """Publish how many frames of a step are taken."""
        self.feedback.words = "measuring"
        self.feedback.frame, self.feedback.frames = step.taken, len(step.patterns)
        self.goal.goal.publish_feedback(self.feedback)
