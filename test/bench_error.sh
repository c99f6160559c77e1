#!/bin/sh
# Error at equal time: relMSE against a long reference, several seeds each. Reports, asserts nothing.
#
#   sh test/bench_error.sh ./mlt [SECONDS [SEEDS [REFERENCE_SECONDS [FOLDER]]]]
#
# SECONDS is one number (2), and then mlt is also run with one strategy left out at a time; or several ('0.5 1 2 4', which is the default), and then
# error is followed over time for path, bdpt, mlt with bidirectional mutations alone, and mlt. Loading and start-up count. SCENES in the
# environment names other scenes, FILM (1) a factor on the films' width and height. What comes out is FOLDER/error.csv or FOLDER/ways.csv, a table, and, over time, a slope for each way and
# FOLDER/error-SCENE.svg (test/bench_plot.c). The default takes 25 minutes, one number 7 minutes a second.
#
# The films are small, so that few seconds stand for the minutes of a large one. References are kept in FOLDER and used again: by the path
# tracer where it converges (cornell, glossy), else by mlt with another seed. furnace has no place here: its paths are all alike.
mlt=$1
seconds=${2:-0.5 1 2 4}
seeds=${3:-8}
reference=${4:-60}
folder=${5:-build/bench}
mkdir -p "$folder" || exit 1
film=${FILM:-1}
size() { case $1 in cornell) echo $((64 * film))x$((64 * film)) ;; glossy) echo $((96 * film))x$((64 * film)) ;; *) echo $((80 * film))x$((60 * film)) ;; esac; }
how() { case $1 in cornell | glossy) echo path ;; *) echo mlt ;; esac; }
case $seconds in *' '*) name=error ;; *) name=ways ;; esac
csv=$folder/$name.csv
echo 'scene,way,seconds,seed,relmse' >"$csv"

# run SCENE WAY [OPTION ...]
run() {
    scene=$1
    way=$2
    shift 2
    for t in $seconds; do
        seed=1
        while [ "$seed" -le "$seeds" ]; do
            "$mlt" -q -s "$(size "$scene")" -t "$t" --seed "$seed" -o "$folder/run.$$.pfm" "$@" "scenes/$scene.obj" || exit 1
            echo "$scene,$way,$t,$seed,$("$mlt" compare "$folder/run.$$.pfm" "$folder/$scene.pfm" | sed -n 's/^relmse //p')" >>"$csv"
            seed=$((seed + 1))
        done
    done
    rm -f "$folder/run.$$.pfm"
}

for scene in ${SCENES:-cornell glossy door caustic pool}; do
    if [ ! -f "$folder/$scene.pfm" ] || [ ! -f "$folder/$scene.json" ]; then
        "$mlt" -q -s "$(size "$scene")" -t "$reference" --seed 1000 --integrator "$(how "$scene")" -o "$folder/$scene.pfm" --stats "$folder/$scene.json" "scenes/$scene.obj" || exit 1
    fi
    # how good the reference itself is, by its own account
    awk -v scene="$scene" -F '[:,]' '/"seconds_total"/ { t = $2 + 0 } /"estimated_relative_error"/ { print scene ",reference," t ",1000," $2 * $2 }' "$folder/$scene.json" >>"$csv"
    run "$scene" path --integrator path
    run "$scene" bdpt --integrator bdpt
    run "$scene" 'mlt bidir alone' --strategies bidir
    run "$scene" mlt
    [ "$name" = ways ] || continue
    run "$scene" '- lens' --strategies bidir,caustic,chain,subpath,manifold
    run "$scene" '- subpath' --strategies bidir,lens,caustic,chain,manifold
    case $scene in cornell | glossy) continue ;; esac       # nothing specular: never proposed
    run "$scene" '- caustic' --strategies bidir,lens,chain,subpath,manifold
    run "$scene" '- chain' --strategies bidir,lens,caustic,subpath,manifold
    run "$scene" '- manifold' --strategies bidir,lens,caustic,chain,subpath
done
[ -x build/main/bench_plot ] || make -s build/main/bench_plot || exit 1
build/main/bench_plot "$csv" "$folder"
