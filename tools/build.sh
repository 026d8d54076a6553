#!/bin/sh
# Builds our packages into a virtual environment, and compiles and caches the hot functions.
#
#   tools/build.sh FOLDER
set -eu
folder=$1
name=$(basename "$folder")
python=$folder/bin/python

echo "Build: insdvl, ros_insdvl and ros_insdvl_sim go into $folder."
# Compiled functions are kept in the user's cache, which outlives a build.
export INSDVL_CACHE_DIR="${INSDVL_CACHE_DIR:-${XDG_CACHE_HOME:-$HOME/.cache}/insdvl}"
# A module that was deleted or renamed must not live on in the environment.
site=$("$python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
rm -rf "build/$name" "$site"/insdvl "$site"/insdvl-* "$site"/ros_insdvl* \
    "$folder"/lib/ros_insdvl* "$folder"/share/insdvl "$folder"/share/ros_insdvl*
mkdir -p build
"$folder/bin/colcon" --log-base "log/$name" build --merge-install \
    --build-base "build/$name" --install-base "$folder" --event-handlers console_direct- \
    >"build/$name.log" 2>&1 || {
    cat "build/$name.log" >&2
    echo "The build failed: colcon says why above." >&2
    exit 1
}
"$folder/bin/insdvl" warm
