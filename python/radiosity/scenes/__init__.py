"""Built-in scenes: rooms whose light is known, and two that are worth looking at.

All lengths in m, emission in W/m^2. Triangles run counter-clockwise seen from the side that light reaches (their
front), and `names` says which object a patch belongs to. Every function takes `max_edge`: the scene is then subdivided
until no edge is longer, and stays without T-junctions. In the rooms walls meet in shared vertices; in theatre and
gallery furniture stands on floors that run on beneath it.

    cornell_box       the box of Goral et al. (1984), dimensions as measured at Cornell University; open at the front
    furnace           a closed cavity of one material; B = E / (1 - rho) everywhere, exactly
    parallel_plates   two squares; their form factor has a closed form
    two_rooms         two rooms and a door; all light of the second comes through the door
    colonnade         a hall with a double row of pillars, which throw shadows of two colours
    mirror_and_glass  the Cornell box with a mirror for its back wall and a glass sphere
    gallery           rooms with pictures, plinths and benches under skylights, and a window
    crater            a bowl under the open sky; what is scattered in it has a closed form
    city              seven buildings under the open sky
    theatre           a stage, stepped seats, a balcony, spotlights and ceiling lights; 50,000 triangles and more
"""

from .gallery import gallery, gallery_view
from .outdoors import city, city_view, crater
from .rooms import colonnade, cornell_box, cornell_box_view, furnace, parallel_plates, two_rooms
from .specular import mirror_and_glass, mirror_and_glass_view
from .theatre import theatre, theatre_view

__all__ = [
    "city",
    "city_view",
    "colonnade",
    "cornell_box",
    "cornell_box_view",
    "crater",
    "furnace",
    "gallery",
    "gallery_view",
    "mirror_and_glass",
    "mirror_and_glass_view",
    "parallel_plates",
    "theatre",
    "theatre_view",
    "two_rooms",
]
