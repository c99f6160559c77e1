#!/bin/sh
# Many runs of mlt with GNU parallel, one on each core at a time, then the merged picture. See doc/cluster.md.
#
#     sh doc/parallel.sh FOLDER RUNS SCENE.obj [OPTION ...]       from the folder that mlt is in; -t or -n among the options
#
# MACHINES names a file of hosts, one a line, that see this folder under the same name (parallel's --sshloginfile). Interrupted, each run saves its state; called
# again with the same words, each goes on from there: with -n those that were done end at once, with -t each works for so long again.
folder=$1
runs=$2
scene=$3
shift 3
mkdir -p "$folder" || exit 1
export folder scene MLT="${MLT:-./mlt}"
seq 1 "$runs" | parallel --will-cite ${MACHINES:+--sshloginfile "$MACHINES" --workdir "$PWD" --env folder --env scene --env MLT} --termseq TERM,10000,KILL,25 \
    'run="$folder"/{}; if [ -e "$run.run" ]; then resume="--resume=$run.run"; else resume=-q; fi
     exec "$MLT" -q "$resume" --seed {} --save "$run.run" -o "$run.pfm" "$scene"' "$@" || exit 1
"$MLT" merge -v -o "$folder/merged.pfm" -o "$folder/merged.png" "$folder"/*.run
