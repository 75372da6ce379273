"""Writes what a calibration found: lens files, report.json and report.html."""

from calib.report.lens_files import write_lens
from calib.report.page import write_report_page
from calib.report.result import Result
from calib.report.values import write_report_json
