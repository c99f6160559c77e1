#!/bin/sh
#SBATCH --job-name=mlt
#SBATCH --array=1-64
#SBATCH --time=01:10:00
#SBATCH --ntasks=1
#SBATCH --cpus-per-task=1
#SBATCH --mem=2G
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --signal=B:TERM@60
# One run of mlt for each task of a Slurm job array; the number of the task is the seed. See doc/cluster.md.
#
#     sbatch doc/slurm.sh FOLDER SCENE.obj [OPTION ...]           from the folder that mlt is in; -t or -n among the options
#
# The folder must be seen by all machines. 'exec' makes mlt the process that Slurm signals: on SIGTERM, a minute before the time is over or when
# the job is preempted, it saves its state; a task that is put into the queue again goes on from there.
folder=$1
scene=$2
shift 2
mkdir -p "$folder" || exit 1
run=$folder/$SLURM_ARRAY_TASK_ID
if [ -e "$run.run" ]; then set -- --resume "$run.run" "$@"; fi
exec "${MLT:-./mlt}" -q "$@" --seed "$SLURM_ARRAY_TASK_ID" --save "$run.run" -o "$run.pfm" "$scene"
