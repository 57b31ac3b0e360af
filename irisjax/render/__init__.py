"""Pictures of eyes: corneal optics, two integrators, lights and cameras."""
