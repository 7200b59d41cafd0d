#!/bin/sh
# Makes this computer fit for USB-RS485 adapters: udev rule, group, real-time rights. Needs root, once.
#
#   sudo tools/setup_adapter.sh [USER]     (default: who called sudo)
#   tools/setup_adapter.sh --print [USER]  only says what it would do
#
# DESTDIR: another root directory (for packages and tests); then only files are written.
set -eu

print=no
if [ "${1-}" = --print ]; then
    print=yes
    shift
fi
case "${1-}" in
-*)
    echo "usage: setup_adapter.sh [--print] [USER]" >&2
    exit 2
    ;;
esac
user=${1-${SUDO_USER-}}
root=${DESTDIR-}
here=$(CDPATH='' cd -- "$(dirname -- "$0")" && pwd)
rules=$root/etc/udev/rules.d/99-dpstack.rules
limits=$root/etc/security/limits.d/99-dpstack.conf

if [ "$print" = no ] && [ -z "$root" ] && [ "$(id -u)" -ne 0 ]; then
    echo "setup_adapter.sh: needs root: sudo $0 ${user:-USER}" >&2
    exit 1
fi

run() {
    echo "+ $*"
    if [ "$print" = no ]; then "$@"; fi
}

run mkdir -p "$(dirname "$rules")" "$(dirname "$limits")"
run cp "$here/99-dpstack.rules" "$rules"
echo "+ write $limits: @dialout rtprio 50, nice -20, memlock unlimited"
if [ "$print" = no ]; then
    printf '%s\n' '@dialout - rtprio 50' '@dialout - nice -20' '@dialout - memlock unlimited' >"$limits"
fi
if [ -z "$root" ]; then
    getent group dialout >/dev/null || run groupadd -r dialout # some distributions have it not
    if [ -n "$user" ] && [ "$user" != root ]; then
        run usermod -aG dialout "$user"
    fi
    run udevadm control --reload
    run udevadm trigger --subsystem-match=tty --subsystem-match=usb-serial
fi
echo "done: plug the adapter in again and log in again, then look with: dpstack doctor"
