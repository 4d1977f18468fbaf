"""Device backends; each is found by name through `lfcal.acquire.registry`."""
