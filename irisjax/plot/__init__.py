"""Figures of spectra, BRDFs and fits. matplotlib is imported when one is asked for."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
