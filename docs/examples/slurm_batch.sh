#!/bin/bash
# A batch on Slurm, second part: the scheduler and the batch, on a folder that all nodes share.
# Requeued, it goes on where it stopped. Not run by our tests.
#SBATCH --job-name=maps
#SBATCH --cpus-per-task=2
#SBATCH --mem=4G
#SBATCH --time=08:00:00
#SBATCH --requeue
rm -f "$HOME/maps.json"
dask scheduler --scheduler-file "$HOME/maps.json" --no-dashboard &
until [ -s "$HOME/maps.json" ]; do sleep 1; done
address=$(python -c 'import json, sys; print(json.load(sys.stdin)["address"])' < "$HOME/maps.json")
specmap batch /shared/logs -o /shared/maps --scheduler "$address" --quiet
