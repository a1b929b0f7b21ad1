# SPDX-License-Identifier: Apache-2.0
"""The report of a benchmark set: one HTML file that opens offline, and a PNG strip. Stage: report."""
