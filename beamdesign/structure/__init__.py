"""Beams and tubes: sections, materials, stock, buckling, and the spring and mass that stand for a beam at its tip."""
