# SPDX-License-Identifier: Apache-2.0
"""Pictures as SVG elements inside a page: strokes and fills by class, colours from the page."""
