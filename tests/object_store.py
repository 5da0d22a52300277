"""An S3 server on loopback that notes requests and refuses keys."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from typing import Any

import fsspec
from moto.moto_server.werkzeug_app import DomainDispatcherApplication, create_backend_app
from werkzeug.serving import WSGIRequestHandler, make_server

__all__ = ["ObjectStore", "object_store"]

BUCKET = "bucket"


class ObjectStore:
    """The server. Objects are in one bucket.

    Attributes:
        address: Its address, ``http://127.0.0.1:PORT``.
        denied: Paths that it refuses.
        errors: Paths that it answers with an error of S3: status and code. That for HEAD has no code.
        before: Functions that are called before the request for a path.
        ranges: The ranges that were requested of each path, None for a whole object.
    """

    def __init__(self) -> None:
        self.address = ""
        self.denied: set[str] = set()
        self.errors: dict[str, tuple[str, str]] = {}
        self.before: dict[str, Callable[[], None]] = {}
        self.ranges: dict[str, list[str | None]] = {}
        self._application = DomainDispatcherApplication(create_backend_app)

    def __call__(self, environment: dict[str, Any], start: Callable[..., Any]) -> Any:
        """Answers a request."""
        path = environment["PATH_INFO"]
        if environment["REQUEST_METHOD"] == "GET":
            self.ranges.setdefault(path, []).append(environment.get("HTTP_RANGE"))
            self.before.get(path, lambda: None)()
        if path in self.denied:
            start("403 Forbidden", [("Content-Length", "0")])
            return []
        if path in self.errors:
            status, code = self.errors[path]
            text = f"<Error><Code>{code}</Code><Message>What S3 says.</Message></Error>"
            body = b"" if environment["REQUEST_METHOD"] == "HEAD" else text.encode()
            start(status, [("Content-Length", str(len(body))), ("Content-Type", "application/xml")])
            return [body]
        return self._application(environment, start)

    @property
    def options(self) -> dict[str, Any]:
        """The storage options of URLs."""
        return {"endpoint_url": self.address, "key": "key", "secret": "secret"}

    @property
    def environment(self) -> dict[str, str]:
        """The variables for URLs without options."""
        names = ("AWS_ENDPOINT_URL", "AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY")
        return dict(zip(names, self.options.values(), strict=True))

    def put(self, name: str, data: bytes) -> str:
        """Stores an object, and returns its URL."""
        system = fsspec.filesystem("s3", **self.options)
        system.pipe(f"{BUCKET}/{name}", data, ACL="public-read")
        self.ranges.pop(self.path(name), None)
        return f"s3://{BUCKET}/{name}"

    def path(self, name: str) -> str:
        """Returns the path of an object in requests."""
        return f"/{BUCKET}/{name}"

    def bytes_requested(self, name: str) -> int:
        """Returns the number of bytes of an object that were requested. All requests must be ranges."""
        total = 0
        for text in self.ranges.get(self.path(name), []):
            assert text is not None, "a whole object was requested"
            start, end = text.removeprefix("bytes=").split("-")
            total += int(end) + 1 - int(start)
        return total


class _Handler(WSGIRequestHandler):
    protocol_version = "HTTP/1.1"

    def log(self, *_: Any) -> None:
        pass


@contextlib.contextmanager
def object_store() -> Iterator[ObjectStore]:
    """Runs a server with an empty bucket."""
    store = ObjectStore()
    server = make_server("127.0.0.1", 0, store, threaded=True, request_handler=_Handler)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    store.address = f"http://127.0.0.1:{server.server_port}"
    fsspec.filesystem("s3", **store.options).mkdir(BUCKET)
    yield store
    server.shutdown()
    thread.join()
    server.server_close()
