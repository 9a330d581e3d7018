#!/bin/sh
# lay_out.sh FOLDER: the library in the layout that the Arduino IDE asks for, e.g. in ~/Arduino/libraries/aminn_rt. Put the
# generated aminn_model.c and .h beside your sketch.
set -eu
here=$(dirname "$0")
mkdir -p "$1/src"
cp "$here/library.properties" "$here/../../LICENSE" "$1/"
cp "$here"/../../runtime/src/* "$here"/../../runtime/include/aminn_rt.h "$here"/../../runtime/include/aminn_hand.h "$1/src/"
