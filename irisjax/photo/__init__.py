"""A photograph of an eye taken apart: its outlines, what refraction hides, thickness and
pigments  [F09].
"""
