"""Mounts a file system that mirrors a folder with a single fault; the part `media` uses it: disk.py FOLDER MOUNTPOINT
CONTROL.

CONTROL is a JSON file that is read at each access: `name` of a file, `offset` in it, and `kind` of the fault at this
offset: `flip` flips a bit of the byte, `EIO` makes reading it fail, and `short` ends reads there.
"""

import errno
import json
import os
import sys

import mfusepy


class Disk(mfusepy.Operations):
    """A read-only file system. It opens a file for each read, which is fast enough here."""

    use_ns = True

    def __init__(self, folder, control):
        self.folder, self.control = folder, control

    def real(self, path):
        return os.path.join(self.folder, path.lstrip("/"))

    def fault(self, path):
        with open(self.control) as file:
            fault = json.load(file)
        return fault if fault.get("name") == path.lstrip("/") else {}

    def getattr(self, path, fh=None):
        found = os.lstat(self.real(path))
        names = ("st_atime_ns", "st_ctime_ns", "st_mtime_ns")
        plain = ("st_gid", "st_mode", "st_nlink", "st_size", "st_uid")
        return {name: getattr(found, name) for name in plain} | {name[:-3]: getattr(found, name) for name in names}

    def readdir(self, path, fh):
        return [".", "..", *os.listdir(self.real(path))]

    def open(self, path, info):
        if info.flags & (os.O_WRONLY | os.O_RDWR):
            raise mfusepy.FuseOSError(errno.EROFS)
        # Bypass the page cache, because the kernel would treat a short read as the end of the file.
        info.direct_io = self.fault(path).get("kind") == "short"
        return 0

    def read(self, path, size, offset, info):
        fault = self.fault(path)
        with open(self.real(path), "rb") as file:
            data = bytearray(os.pread(file.fileno(), size, offset))
        at = fault.get("offset", -1) - offset
        if 0 <= at < len(data):
            if fault["kind"] == "EIO":
                raise mfusepy.FuseOSError(errno.EIO)
            if fault["kind"] == "flip":
                data[at] ^= 1 << fault["bit"]
            if fault["kind"] == "short":
                del data[max(at, 1):]
        return bytes(data)


if __name__ == "__main__":
    source, mount_point, control_file = sys.argv[1:]
    mfusepy.FUSE(Disk(source, control_file), mount_point, foreground=True, nothreads=True, raw_fi=True, ro=True)
