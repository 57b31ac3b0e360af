"""Eyes that cannot be: those of wrong values, and of an iris within the cornea, are refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from irisjax.anatomy.eye import Cornea, Eye, Sclera
from irisjax.optics.conicoid import Conicoid
from irisjax.render.camera import Camera
from irisjax.render.project import project_visible
from irisjax.render.refraction import cornea_point, refract_to_iris

CORNEAS = {
    "single": lambda: Cornea(posterior=None),
    "thick": lambda: Cornea(posterior=Conicoid(6.5, 0.75, 0.8)),
}
# Sagittae at 5.5 mm: 2.1643 mm of the anterior cornea, 0.52 + 2.7694 mm of the posterior one.
SHALLOW = [
    ({}, 3.29),
    ({"iris_slope": 0.1}, 2.74),
    ({"iris_slope": -0.1}, 3.84),
    ({"iris_radius": 7.0}, 3.29),
    ({"cornea": "single", "limbus_radius": 6.2, "iris_radius": 6.2}, 2.857),
    ({"cornea": "single", "limbus_radius": 6.2, "iris_slope": -0.3}, 3.815),
    # The limbus, whatever the root does.
    ({"cornea": "single", "limbus_radius": 6.2, "iris_slope": 0.3}, 2.857),
    ({"cornea": "thick"}, 3.57),
]


@pytest.mark.parametrize(("options", "least"), SHALLOW, ids=[str(i) for i in range(len(SHALLOW))])
def test_least_depth_is_named_and_holds(options, least, bits):
    del bits
    if "cornea" in options:  # made at this precision
        options = options | {"cornea": CORNEAS[options["cornea"]]()}
    shallow = least - 0.002
    message = rf"iris_depth = {shallow:g} mm .* must be at least {least:g} mm"
    with pytest.raises(ValueError, match=message):
        Eye(iris_depth=shallow, **options)
    eye = Eye(iris_depth=least, **options)
    # All that enters within the limbus meets the iris in front of it.
    r = jnp.linspace(0, 1, 50) * jnp.minimum(eye.iris_radius, eye.limbus_radius)
    back = eye.cornea.posterior or eye.cornea.anterior
    slope = 0.0 if eye.iris_slope is None else eye.iris_slope
    assert (eye.iris_depth + slope * r > back.apex + back.sagitta(r)).all()


def test_shallow_eyes_of_other_kinds_stay():
    Eye(iris_depth=3.0, cornea=CORNEAS["single"]())
    Eye(iris_depth=2.5, cornea=None, sclera=None)
    Eye(iris_depth=2.5, iris_radius=4.0)
    with pytest.raises(ValueError, match=r"iris_depth = 3 mm"):
        Eye().replace(iris_depth=3.0)


@pytest.mark.peer
def test_an_eye_just_allowed_is_seen():
    eye = Eye(iris_depth=3.29, pupil_radius=0.25)
    # A ray to each place of the limbus goes forwards through both surfaces to the iris.
    turn = jnp.linspace(0, 2 * jnp.pi, 60)
    entry = cornea_point(eye.cornea, 5.49 * jnp.stack([jnp.cos(turn), jnp.sin(turn)], axis=-1))
    landing = refract_to_iris(
        eye, entry, jnp.broadcast_to(jnp.asarray([0.0, 0.0, 1.0]), entry.shape)
    )
    assert (landing.point[:, 2] > entry[:, 2]).all() and np.isfinite(landing.share).all()
    view = project_visible(eye, Camera(width=12.0, size=(24, 18)))
    assert view.iris is not None and view.iris.index.size > 100


def test_depth_may_be_traced():
    """The check is for numbers that are known; under jit, grad and vmap it stands aside."""

    def lands(depth):
        eye = Eye(iris_depth=depth)
        entry = cornea_point(eye.cornea, jnp.asarray([2.0, 1.0]))
        return refract_to_iris(eye, entry, jnp.asarray([0.0, 0.0, 1.0])).point[0]

    step = 1e-5
    depths = jnp.asarray([3.3, 3.6 - step, 3.6, 3.6 + step])
    found, slopes = jax.jit(jax.vmap(jax.value_and_grad(lands)))(depths)
    assert np.isfinite(found).all() and (found < 2.0).all()
    assert slopes[2] == pytest.approx(float((found[3] - found[1]) / (2 * step)), rel=1e-6)
    # The radius may be traced as well, with a depth that is known.
    jax.eval_shape(lambda r: Eye(iris_depth=3.0, iris_radius=r).iris_radius, 5.0)


def test_arrays_of_a_wrong_shape_are_named():
    with pytest.raises(ValueError, match=r"^tint has shape \(2,\); it must be \(3,\)$"):
        Sclera(tint=np.ones(2))
    message = r"^pupil_harmonics has shape \(4,\); it must be \(harmonics, 2\)$"
    with pytest.raises(ValueError, match=message):
        Eye(pupil_harmonics=np.zeros(4))
