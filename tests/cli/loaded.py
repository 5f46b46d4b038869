"""A program `specmap` that is loaded already: a run of it is a fork, and waits for no imports.

`python -m tests.cli.loaded SOCKET` loads the package and serves. The program that `write_program`
writes sends its arguments, its directory, its environment and its three streams to the socket, and
ends as the fork does that runs them.
"""

import importlib
import json
import os
import pkgutil
import socket
import sys
import traceback
from pathlib import Path
from typing import NoReturn

from specmap_cli import exports, pipelines
from specmap_cli.cli import main

PROGRAM = """\
#!{python} -ISE
import json, os, socket, sys
with socket.socket(socket.AF_UNIX) as server:
    server.connect({place!r})
    run = json.dumps([sys.argv[1:], os.getcwd(), dict(os.environ)])
    socket.send_fds(server, [run.encode()], [0, 1, 2])
    code = server.recv(1)
sys.exit(code[0] if code else 70)
"""


def write_program(path: Path, place: Path) -> None:
    """The program, for a server that listens at `place`."""
    path.write_text(PROGRAM.format(python=sys.executable, place=str(place)), encoding="utf-8")
    path.chmod(0o755)


def serve(place: Path) -> None:
    """Load all, run what is sent, one after the other, until killed; says when it is ready."""
    for package in (pipelines, exports):
        for module in pkgutil.iter_modules(package.__path__, f"{package.__name__}."):
            importlib.import_module(module.name)
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(place))
        listening.listen()
        print("ready", flush=True)
        while True:
            asked, _ = listening.accept()
            if (child := os.fork()) == 0:
                _answer(asked)
            asked.close()
            os.waitpid(child, 0)


def _answer(asked: socket.socket) -> NoReturn:
    """Run the command with the streams, the directory and the environment that came with it."""
    code = 1
    try:
        sent, streams, _, _ = socket.recv_fds(asked, 1 << 20, 3)  # the longest run, in bytes
        arguments, directory, environment = json.loads(sent)
        for number, stream in enumerate(streams):
            os.dup2(stream, number)
        os.chdir(directory)
        os.environ.clear()
        os.environ.update(environment)
        code = main(arguments)
        sys.stdout.flush()
    except Exception:
        traceback.print_exc()
    finally:
        asked.sendall(bytes([code]))
        os._exit(0)


if __name__ == "__main__":
    serve(Path(sys.argv[1]))
