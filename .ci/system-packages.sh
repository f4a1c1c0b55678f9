#!/bin/sh
# Installs the OpenGL system packages of Debian and Ubuntu when they are missing and this user may; else says how.
have() { ldconfig -p 2>/dev/null | grep -q "$1" || ls /usr/lib/*/"$1"* >/dev/null 2>&1; }
need=""
have libEGL.so.1 || need="$need libegl1"
have libGL.so.1 || need="$need libgl1"
{ ls /usr/lib/*/dri/swrast_dri.so >/dev/null 2>&1 || ls /usr/lib/*/libgallium* >/dev/null 2>&1; } || need="$need libgl1-mesa-dri"
if ! have libOSMesa.so; then
    command -v apt-cache >/dev/null 2>&1 && apt-cache show libosmesa6 >/dev/null 2>&1 && need="$need libosmesa6"
fi
[ -z "$need" ] && exit 0
command -v apt-get >/dev/null 2>&1 || { echo "selfscan: OpenGL libraries missing:$need (names as in Debian)"; exit 0; }
if [ "$(id -u)" = 0 ]; then
    apt-get install -y -q $need >/dev/null 2>&1 || { apt-get update -q >/dev/null 2>&1; apt-get install -y -q $need >/dev/null; }
elif sudo -n true 2>/dev/null; then
    sudo apt-get update -q >/dev/null 2>&1; sudo apt-get install -y -q $need >/dev/null
else
    echo "selfscan: OpenGL libraries are missing. Run: sudo apt-get install$need"
fi
exit 0
