#!/usr/bin/env bash
# Test phy124 with what ROS 2 Lyrical has and this machine lacks, in chroots of Debian.
#
#     sudo tests/lts.sh [FOLDER [PYTEST ARGUMENTS...]]
#     sudo tests/lts.sh fastdds [FOLDER]
#
# The first tests the committed files with Python 3.14 in Debian forky, by default those of the
# bridge. There is no wheel of cyclonedds for Python 3.14, so tests of DDS are skipped. The second
# compiles a peer with Fast DDS 3.3 in Debian sid, and tests the DDS backend of the environment .venv
# with it.
#
# FOLDER (default build/forky, build/sid) is made once by debootstrap and needs 2 GB.
set -eu

root=$(cd "$(dirname "$0")/.." && pwd)
suite=forky
if [ "${1:-}" = fastdds ]; then
    suite=sid
    shift
fi
folder=$(realpath -m "${1:-$root/build/$suite}")
[ $# -eq 0 ] || shift
mirror=${DEBIAN_MIRROR:-http://deb.debian.org/debian}
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

if [ ! -e "$folder/etc/debian_version" ]; then
    # An older debootstrap does not know forky; all suites since buster share the script of sid.
    scripts=/usr/share/debootstrap/scripts
    script=$scripts/$suite
    [ -e "$script" ] || script=$scripts/sid
    mkdir -p "$folder"
    debootstrap --variant=minbase --include=ca-certificates "$suite" "$folder" "$mirror" "$script"
fi

# The machine's name server, and its certificates if it has a proxy of its own.
cp /etc/resolv.conf "$folder/etc/resolv.conf"
cp /etc/ssl/certs/ca-certificates.crt "$folder/etc/ssl/certs/ca-certificates.crt"

inside() {
    chroot "$folder" /usr/bin/env -i HOME=/root PATH=/venv/bin:/usr/bin:/bin:/usr/sbin:/sbin \
        LANG=C.UTF-8 DEBIAN_FRONTEND=noninteractive PIP_CERT=/etc/ssl/certs/ca-certificates.crt \
        sh -c "$*"
}

install() {
    inside dpkg --status "$@" > /dev/null 2>&1 && return
    # A mirror that is some days old is good enough.
    inside apt-get -q -o Acquire::Check-Valid-Until=false update
    inside apt-get -q -y -o Acquire::Check-Valid-Until=false install --no-install-recommends "$@"
}

mountpoint -q "$folder/proc" || mount -t proc proc "$folder/proc"
trap 'umount "$folder/proc"' EXIT
mkdir -p "$folder/dev/shm"

if [ $suite = sid ]; then
    install g++ libfastdds-dev libfastcdr-dev fastddsgen default-jre-headless
    rm -rf "$folder/peer"
    cp -r "$root/tests/support/fastdds" "$folder/peer"
    inside "cd /peer && fastddsgen -replace messages.idl &&
        g++ -O1 -o peer peer.cpp messages*.cxx -lfastdds -lfastcdr"
    cd "$root"
    PHY124_FASTDDS="chroot $folder /peer/peer" .venv/bin/pytest -q -m slow tests/test_bridge_fastdds.py
    exit
fi

install python3 python3-venv git libgomp1
rm -rf "$folder/phy124"
mkdir "$folder/phy124"
git -C "$root" archive HEAD | tar -x -C "$folder/phy124"
[ -e "$folder/venv" ] || inside python3 -m venv /venv
inside "cd /phy124 && pip install --quiet --constraint constraints.txt --editable '.[$extras]' $others"
inside python --version
[ $# -gt 0 ] || set -- 'tests/test_bridge_*.py'
inside "cd /phy124 && pytest -q $*"
