"""What a killed run would leave of its workers' socket is taken away, and nothing else."""

from __future__ import annotations

import atexit
from multiprocessing import forkserver
from pathlib import Path

import pytest

from hident.engine import socket_folder

# The tests' process is not the one that forks the workers.
atexit.unregister(socket_folder._remove)


@pytest.mark.parametrize("shared", [False, True])
def test_the_folder_stays_where_it_holds_anything_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shared: bool
) -> None:
    folder = tmp_path / "pymp-1"
    folder.mkdir()
    socket, other = folder / "listener-1", folder / "listener-2"
    socket.touch()
    if shared:
        other.touch()
    monkeypatch.setattr(forkserver._forkserver, "_forkserver_address", str(socket))
    socket_folder._remove()
    assert not socket.exists()
    assert (folder.exists(), other.exists()) == (shared, shared)


@pytest.mark.parametrize("address", [None, b"\0abstract", "/elsewhere/listener-1"])
def test_what_is_no_socket_of_multiprocessing_is_left_alone(
    monkeypatch: pytest.MonkeyPatch, address: object
) -> None:
    monkeypatch.setattr(forkserver._forkserver, "_forkserver_address", address)
    socket_folder._remove()
