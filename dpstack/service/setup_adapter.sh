#!/bin/sh
# Makes this computer fit for USB-RS485 adapters and for dpstack as a service. Needs root, once.
#
#   dpstack doctor --fix          prints what it does, and the command for root
#   setup_adapter.sh [USER]       USER may use the adapters (default: who called sudo)
#   setup_adapter.sh --print [USER]  only says what it would do
#
# udev rule, group, real-time rights; with systemd the unit dpstack@.service, which is not started.
# DESTDIR: another root directory (for packages and tests); then only files are written.
# DPSTACK: the command of the unit (default: dpstack of the PATH).
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
unit=$root/etc/systemd/system/dpstack@.service
program=${DPSTACK-$(command -v dpstack || echo /usr/local/bin/dpstack)}

if [ "$print" = no ] && [ -z "$root" ] && [ "$(id -u)" -ne 0 ]; then
    echo "setup_adapter.sh: needs root: sudo $0 ${user:-USER}" >&2
    exit 1
fi

run() {
    echo "+ $*"
    if [ "$print" = no ]; then "$@"; fi
}

# $1: file, $2: what it has; the text comes from standard input
write() {
    echo "+ write $1: $2"
    if [ "$print" = no ]; then cat >"$1"; fi
}

run mkdir -p "$(dirname "$rules")" "$(dirname "$limits")"
run cp "$here/99-dpstack.rules" "$rules"
printf '%s\n' '@dialout - rtprio 50' '@dialout - nice -20' '@dialout - memlock unlimited' |
    write "$limits" '@dialout rtprio 50, nice -20, memlock unlimited'
if [ -z "$root" ]; then
    getent group dialout >/dev/null || run groupadd -r dialout # some distributions have it not
    if [ -n "$user" ] && [ "$user" != root ]; then
        run usermod -aG dialout "$user"
    fi
    run udevadm control --reload
    run udevadm trigger --subsystem-match=tty --subsystem-match=misc
    # the rule of the latency timer is for adapters that appear
    run udevadm trigger --action=add --subsystem-match=usb-serial
fi
if [ -n "$root" ] || [ -d /run/systemd/system ]; then
    if [ -z "$root" ] && ! id dpstack >/dev/null 2>&1; then
        run useradd --system --user-group --no-create-home --shell /usr/sbin/nologin dpstack
    fi
    run mkdir -p "$(dirname "$unit")" "$root/etc/dpstack"
    awk -v program="$program" '{ gsub(/@DPSTACK@/, program) } 1' "$here/dpstack@.service" |
        write "$unit" "runs $program run /etc/dpstack/NAME.toml as the user dpstack"
    if [ -z "$root" ]; then
        run systemctl daemon-reload
    fi
fi
echo "done: log in again (for the group), then look with: dpstack doctor"
