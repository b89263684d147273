"""The local server of a product: loopback only, read only, made of named files."""

from __future__ import annotations

import contextlib
import logging
import mimetypes
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final, Protocol

import uvicorn
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from stereomate.errors import ImageError, InputError, StereomateError, StorageError

LOG = logging.getLogger(__name__)

# Nothing but this server's own files, no code in the page itself, and no other page around it.
POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_MEDIA: Final = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".json": "application/json",
    ".jpg": "image/jpeg",
    ".png": "image/png",
    ".bin": "application/octet-stream",
}
# Other names of this machine would let a foreign page read the product through the browser.
_HOSTS: Final = ["localhost", "127.0.0.1", "[::1]"]
# Requests that are still answered when the server is told to end, seconds.
_LEAVE_S: Final = 2
# What a check of large files may not take from the first picture, seconds.
CHECK_AFTER_S: Final = 4.0


class Files(Protocol):
    """Where the files come from: a `Site`, or a published folder."""

    def read(self, name: str) -> bytes:
        """A file; KeyError if there is none of that name."""
        ...


class PublishedFolder:
    """The files of a published site. Nothing outside its folder is read, whatever links lead there."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder.resolve()

    def read(self, name: str) -> bytes:
        """A file.

        Raises
        ------
        KeyError
            If there is none, it is hidden, or it lies outside.
        """
        parts = name.split("/")
        if any(part in ("", ".", "..") or part.startswith(".") or "\\" in part for part in parts):
            raise KeyError(name)
        path = self._folder.joinpath(*parts)
        if not path.is_file() or path.resolve() != path:
            raise KeyError(name)
        return path.read_bytes()


def application(files: Files) -> Starlette:
    """The application that gives the files by GET, and nothing else."""

    def give(request: Request) -> Response:
        name = request.path_params["name"] or "index.html"
        try:
            content = files.read(name)
        except KeyError:
            return Response("not found", 404, media_type="text/plain", headers=_headers())
        except (ImageError, StorageError, OSError) as error:
            LOG.warning("%s: %s", name, error)
            return Response("cannot be read", 500, media_type="text/plain", headers=_headers())
        suffix = Path(name).suffix
        media = _MEDIA.get(suffix) or mimetypes.guess_type(name)[0] or "application/octet-stream"
        kept = "private, max-age=31536000, immutable" if request.query_params.get("v") else "no-cache"
        return Response(content, media_type=media, headers=_headers() | {"Cache-Control": kept})

    return Starlette(
        routes=[Route("/{name:path}", give, methods=["GET"])],
        middleware=[Middleware(TrustedHostMiddleware, allowed_hosts=_HOSTS, www_redirect=False)],
    )


def _headers() -> dict[str, str]:
    return {
        "Content-Security-Policy": POLICY,
        "X-Content-Type-Options": "nosniff",
        "Referrer-Policy": "no-referrer",
        "Cross-Origin-Resource-Policy": "same-origin",
        "Cross-Origin-Opener-Policy": "same-origin",
    }


def serve(
    files: Files,
    port: int = 0,
    ready: Callable[[str], None] | None = None,
    check: Callable[[], None] | None = None,
) -> None:
    """Serve on loopback until interrupted.

    Parameters
    ----------
    port : int
        0 takes a free one.
    ready : callable, optional
        Called with the address once the port is taken.
    check : callable, optional
        Called in a thread of its own when the first picture has had its time; what it raises ends the server.

    Raises
    ------
    InputError
        If the port is taken by another program.
    StereomateError
        Of `check`.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind(("127.0.0.1", port))
            # from here on a browser may ask: it waits for the answer
            listener.listen(128)
        except OSError as error:
            raise InputError(f"cannot be used: {error.strerror}", field="port", value=port) from error
        address = f"http://127.0.0.1:{listener.getsockname()[1]}/"
        config = uvicorn.Config(
            application(files),
            log_level="error",
            access_log=False,
            lifespan="off",
            server_header=False,
            timeout_graceful_shutdown=_LEAVE_S,
        )
        if ready is not None:
            ready(address)
        server, failed = uvicorn.Server(config), list[StereomateError]()

        def look() -> None:
            time.sleep(CHECK_AFTER_S)
            try:
                if check is not None:
                    check()
            except StereomateError as error:
                failed.append(error)
                server.should_exit = True

        # one who leaves does not wait for it
        threading.Thread(target=look, daemon=True).start()
        # the server ends in peace and then hands the interruption on: here it is how one leaves
        with contextlib.suppress(KeyboardInterrupt):
            server.run(sockets=[listener])
    if failed:
        raise failed[0]
