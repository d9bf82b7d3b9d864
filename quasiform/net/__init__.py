"""The flat sheet: outline, net of fibre lines, mesh."""
