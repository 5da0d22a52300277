"""Errors of the system in words: what failed, where, and the remedy."""

from __future__ import annotations

import errno

from xbus.errors import BusError

__all__ = ["file_failure", "port_failure", "system_error"]

#: Remedies for files, by error number.
FILE_REMEDIES = {
    errno.ENOENT: "check the path",
    errno.ENOTDIR: "check the path",
    errno.EEXIST: "choose another name",
    errno.EISDIR: "name files, such as DIR/*.mtb",
    errno.EACCES: "get the permission, or work on a copy",
    errno.EPERM: "get the permission, or work on a copy",
    errno.EROFS: "choose another folder",
    errno.ENOSPC: "free some space, or write to another disk",
    errno.EDQUOT: "free some space, or write to another disk",
    errno.EFBIG: "raise the limit (ulimit -f), or write fewer quantities",
    errno.EPROTONOSUPPORT: "check the URL",
    errno.ENODEV: "xbus record writes what a device sends to a file",
    errno.ENXIO: "name a file or a pipe",
    errno.EBADF: "redirect it to a file, or to /dev/null",
}
#: Remedies for a port that cannot be opened, by error number.
PORT_REMEDIES = {
    errno.ENOENT: "xbus ports lists the serial ports",
    errno.EACCES: "get the permission; xbus doctor prints the command",
    errno.EAGAIN: "close the program that uses it",
    errno.EBUSY: "close the program that uses it",
    errno.ECONNREFUSED: "start the program that listens on it",
}


def file_failure(action: str, error: OSError) -> str:
    """Returns the sentence for an action, such as "read walk.mtb", that an error of the system ended.

    >>> file_failure("read walk.mtb", FileNotFoundError(errno.ENOENT, "No such file or directory"))
    'cannot read walk.mtb: No such file or directory; check the path'
    """
    remedy = FILE_REMEDIES.get(error.errno or 0, "try again, or check the disk")
    return f"cannot {action}: {error.strerror or error}; {remedy}"


def port_failure(port: str, error: OSError) -> str:
    """Returns the sentence for a port that cannot be opened."""
    if isinstance(error, BusError):
        return str(error)
    number, text = system_error(error)
    remedy = PORT_REMEDIES.get(number, "xbus ports lists the serial ports")
    return f"cannot open {port}: {text}; {remedy}"


def system_error(error: OSError) -> tuple[int, str]:
    """Returns number and text of a system error, even if pyserial has wrapped it."""
    match (error.__context__ or error).args:
        case (int(number), str(text), *_):
            return number, text
    return 0, str(error)
