"""Scenes to and from Mitsuba 3, and its path tracer as an independent reference for radiosity.

A path tracer solves the same equation as this package by other means, and knows no patches:

    B_i = E_i + 1/A_i * integral over patch i of pi * L(x) dA,      L(x) = light reflected at x, W/(m^2 sr)

so the average of `pi * L` over random points of a patch is its radiosity without any discretisation error, with a
standard error that falls as one over the square root of the number of paths.

What Mitsuba computes in 32 bits has limits, and `reference_radiosity` stays inside them where it can: it centres and
scales the scene (Mitsuba lifts its rays off a surface by about (1 + max|p|) * 9e-5, an absolute length) and does
without Russian roulette where roulette would make the variance infinite. What remains: a gap or a patch thinner than
about 1e-4 of the scene's size is not resolved, and a tiny lamp close to a wall converges so slowly that the standard
error is not to be trusted. Hold such scenes against closed forms.

Mitsuba itself is optional and is imported by the functions that need it: `pip install radiosity[mitsuba]`.
"""

from .reading import from_mitsuba
from .reference import reference_radiosity
from .variant import variant
from .writing import to_mitsuba

__all__ = ["from_mitsuba", "reference_radiosity", "to_mitsuba", "variant"]
