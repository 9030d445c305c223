"""Virtual HID devices for the real hidapi: no hardware, no change to the library.

model.py        what a device is, what befalls it, what it saw
descriptors.py  report descriptors; gloves and game controllers
behaviour.py    a hidraw node: calls in, answers out; pure
fuse_wire.py    the protocol of /dev/fuse
fuse.py         a device served through it
uhid.py         a device by the kernel's own uhid
umock.py        a device by the library umockdev
control.py      what a test may ask of a device; log.py what it saw; channel.py the way between
sysfs.py        the files that libudev reads of it
linux.py        mount, unshare and others
keeper.py       process 1 of a private world: mounts, servers, commands
world.py        the world as tests use it; virtual.py its devices, running.py its commands
"""
