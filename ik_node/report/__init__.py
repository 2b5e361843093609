"""Runs in figures and in pictures."""

from ik_node.report.ground_truth import FILE_NAME, Truth, read_truth, truth_from, truth_from_targets, write_truth
from ik_node.report.metrics import Report, figures
from ik_node.report.text import as_json, as_plain, as_text

__all__ = [
    "FILE_NAME",
    "Report",
    "Truth",
    "as_json",
    "as_plain",
    "as_text",
    "figures",
    "read_truth",
    "truth_from",
    "truth_from_targets",
    "write_truth",
]
