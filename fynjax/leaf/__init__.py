"""Leaf optics: PROSPECT, forward and backward."""

from fynjax.leaf._coefficients import ProspectVersion
from fynjax.leaf._parameters import LeafParameters
from fynjax.leaf._prospect import LeafOptics, interface_transmissivity, prospect
from fynjax.leaf._transmissivity import exponential_integral, layer_absorptance

__all__ = [
    "LeafOptics",
    "LeafParameters",
    "ProspectVersion",
    "exponential_integral",
    "interface_transmissivity",
    "layer_absorptance",
    "prospect",
]
