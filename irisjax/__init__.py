"""irisjax: a predictive model of the human iris, from pigments to spectra, colour and BRDF.

`import irisjax as ij`; units are nm, mm, mg/ml, mmol/l and radians throughout.
"""

import lazy_loader

# `__init__.pyi` lists the public names. Each loads when it is first used: a spectrum needs neither
# optimistix nor emcee nor the renderer.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

__version__ = "0.1.0"
