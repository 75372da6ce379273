"""Held-out figures and the report of a run."""

from gsut.evaluate.detail import is_beside
from gsut.evaluate.evaluation import evaluate, run_metrics
from gsut.evaluate.held_out import mean_psnr
from gsut.evaluate.report import write_report
from gsut.evaluate.report_plots import name_ring
from gsut.evaluate.scene_page import write_scene_page
