#!/usr/bin/env bash
# Test phy124 with Python 3.14, that of ROS 2 Lyrical, in a chroot of Debian forky.
#
#     sudo tests/lts.sh [FOLDER [PYTEST ARGUMENTS...]]
#
# FOLDER (default build/forky) is made once by debootstrap and needs 2 GB. The committed files are
# tested. Without further arguments the tests of the bridge are run. There is no wheel of cyclonedds
# for Python 3.14, so tests of DDS are skipped.
set -eu

root=$(cd "$(dirname "$0")/.." && pwd)
folder=$(realpath -m "${1:-$root/build/forky}")
[ $# -eq 0 ] || shift
mirror=${DEBIAN_MIRROR:-http://deb.debian.org/debian}
packages=python3,python3-venv,ca-certificates,git,libgomp1
extras='bridge,foxglove,draco'
others='pytest hypothesis rosbags catkin_pkg setuptools'

if [ "$(id -u)" != 0 ]; then
    echo "debootstrap and chroot need root: sudo $0" >&2
    exit 1
fi
if ! command -v debootstrap > /dev/null; then
    echo "debootstrap is missing: apt install debootstrap" >&2
    exit 1
fi

if [ ! -e "$folder/usr/bin/python3" ]; then
    # An older debootstrap does not know forky; all suites since buster share the script of sid.
    scripts=/usr/share/debootstrap/scripts
    script=$scripts/forky
    [ -e "$script" ] || script=$scripts/sid
    mkdir -p "$folder"
    debootstrap --variant=minbase --include="$packages" forky "$folder" "$mirror" "$script"
fi

# The machine's name server, and its certificates if it has a proxy of its own.
cp /etc/resolv.conf "$folder/etc/resolv.conf"
cp /etc/ssl/certs/ca-certificates.crt "$folder/etc/ssl/certs/ca-certificates.crt"

rm -rf "$folder/phy124"
mkdir "$folder/phy124"
git -C "$root" archive HEAD | tar -x -C "$folder/phy124"

inside() {
    chroot "$folder" /usr/bin/env -i HOME=/root PATH=/venv/bin:/usr/bin:/bin LANG=C.UTF-8 \
        PIP_CERT=/etc/ssl/certs/ca-certificates.crt \
        sh -c "cd /phy124 && $*"
}

mountpoint -q "$folder/proc" || mount -t proc proc "$folder/proc"
trap 'umount "$folder/proc"' EXIT
mkdir -p "$folder/dev/shm"

[ -e "$folder/venv" ] || inside python3 -m venv /venv
inside pip install --quiet --constraint constraints.txt --editable "'.[$extras]'" $others
inside python --version
[ $# -gt 0 ] || set -- 'tests/test_bridge_*.py'
inside python -m pytest -q "$@"
