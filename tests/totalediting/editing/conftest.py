import pytest
from known_faces import an_editor

from totalediting.editing import subject


@pytest.fixture
def editor(monkeypatch):
    monkeypatch.setattr(subject, "_SIDES", (96, 96))
    return an_editor()
