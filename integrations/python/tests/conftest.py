import pytest

import patchlight


@pytest.fixture(scope="session")
def cornell() -> patchlight.Scene:
    return patchlight.Scene.load("cornell")


@pytest.fixture(scope="session")
def bake(cornell: patchlight.Scene) -> patchlight.Bake:
    return cornell.bake(patches=250, receiver_rays=512)
