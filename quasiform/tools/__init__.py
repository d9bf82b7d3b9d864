"""Rigid tools by their signed distance: closed forms, spline grids, surface and CAD files."""
