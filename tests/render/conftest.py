"""Tables of light through a clear cornea, made once."""

import pytest


@pytest.fixture(scope="session")
def tables():
    """Of the default eye without haze, half as fine as usual."""
    from irisjax.anatomy.eye import Cornea, Eye
    from irisjax.render.illumination import Illumination

    return Illumination.build(Eye(cornea=Cornea(scatter=None)), caustics=False, size=65)
