"""The paper, judged: its experiments run again, and what they show of its claims."""

from stereo_slam_env.studies.paper.claims import Claim, Finding, Interval, Range, Verdict
from stereo_slam_env.studies.paper.settings import FULL, QUICK, PaperSettings
from stereo_slam_env.studies.paper.study import PaperResult, run_paper

__all__ = [
    "FULL",
    "QUICK",
    "Claim",
    "Finding",
    "Interval",
    "PaperResult",
    "PaperSettings",
    "Range",
    "Verdict",
    "run_paper",
]
