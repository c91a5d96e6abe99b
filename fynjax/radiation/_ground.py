"""How the ground reflects: Lambert's law, or the shape of Rahman, Pinty and Verstraete."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float


class RahmanPintyVerstraete(eqx.Module):
    """Anisotropic ground (Rahman, Pinty and Verstraete 1993, eq. 1-9).

    The bidirectional reflectance factor is the scene's `ground`, here the amplitude rho_0 of the
    model, times a shape in three parameters. Lambert's law is k = 1, theta = 0, rho_c = 1.
    """

    k: Float[Array, " band"] = eqx.field(converter=jnp.asarray)
    """Bowl (below 1) or bell (above 1) of the shape [-]."""
    theta: Float[Array, " band"] = eqx.field(converter=jnp.asarray)
    """Asymmetry of the Henyey-Greenstein term [-], -1 to 1; negative scatters backward."""
    rho_c: Float[Array, " band"] = eqx.field(converter=jnp.asarray)
    """Parameter of the hot spot [-]; 1 has none, rho_0 is a usual value."""

    def shape(
        self, incoming: Float[Array, "incoming 3"], outgoing: Float[Array, "outgoing 3"]
    ) -> Float[Array, "band incoming outgoing"]:
        """Reflectance factor over rho_0, for light that travels along unit vectors `incoming`
        (downward) and `outgoing` (upward). Differentiable; symmetric in the two directions."""
        dtype = incoming.dtype
        cos_in = jnp.maximum(-incoming[:, 2], 1e-3)[:, None]
        cos_out = jnp.maximum(outgoing[:, 2], 1e-3)[None, :]
        k, theta, rho_c = (p.astype(dtype)[:, None, None] for p in (self.k, self.theta, self.rho_c))
        bowl = (cos_in * cos_out * (cos_in + cos_out)) ** (k - 1.0)
        # Cosine of the phase angle: one where the light goes back to where it came from.
        phase = -incoming @ outgoing.T
        lobe = (1.0 - theta**2) / (1.0 + 2.0 * theta * phase + theta**2) ** 1.5
        # The horizontal distance between the two directions' tangent points.
        apart = (
            -incoming[:, None, :2] / cos_in[..., None] - outgoing[None, :, :2] / cos_out[..., None]
        )
        square = jnp.sum(apart**2, axis=-1)
        distance = jnp.sqrt(jnp.where(square > 0, square, 1.0)) * (square > 0)
        return bowl * lobe * (1.0 + (1.0 - rho_c) / (1.0 + distance))
