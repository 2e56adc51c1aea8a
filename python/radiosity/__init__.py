"""Diffuse light and heat between the surfaces of a 3-D scene.

::

    import radiosity as rad

    scene = rad.load("room.glb")
    solution = rad.solve(scene, tolerance=0.01)
    image = rad.render(solution, rad.Camera((0, -4, 1.5), (0, 0, 1.2)))
    rad.save_image("room.png", image)

Conventions: F[i, j] is the fraction of what leaves patch i that reaches patch j (row = emitter). B = E + rho H with
radiosity B, emission E and irradiance H in W/m^2; a diffuse radiance is B / pi. Lengths are metres. Surfaces are
one-sided, counter-clockwise seen from the front.
"""

from importlib.metadata import version as _version

from . import distributed, gradients, mitsuba, plot, scenes
from .bounces import bounces
from .form_factors import FormFactors, form_factor, form_factors, load_form_factors, pair_form_factors
from .instant import VirtualLights, instant, virtual_lights
from .lights import PointLight, Sky, SpotLight, Sun, direct_irradiance, sky_coefficients
from .load import load
from .render import Camera, render, save_image, two_pass
from .save import load_solution, save
from .scene import Scene
from .solution import ConvergenceError, Forecast, Gradient, Solution
from .solve import forecast, solve
from .system import Solutions, ambient, solve_system
from .transfer import transfer
from .view import View, show

__version__ = _version("radiosity")

__all__ = [
    "Camera",
    "ConvergenceError",
    "Forecast",
    "FormFactors",
    "Gradient",
    "PointLight",
    "Scene",
    "Sky",
    "Solution",
    "Solutions",
    "SpotLight",
    "Sun",
    "View",
    "VirtualLights",
    "ambient",
    "bounces",
    "direct_irradiance",
    "distributed",
    "forecast",
    "form_factor",
    "form_factors",
    "gradients",
    "instant",
    "load",
    "load_form_factors",
    "load_solution",
    "mitsuba",
    "pair_form_factors",
    "plot",
    "render",
    "save",
    "save_image",
    "scenes",
    "show",
    "sky_coefficients",
    "solve",
    "solve_system",
    "transfer",
    "two_pass",
    "virtual_lights",
]
