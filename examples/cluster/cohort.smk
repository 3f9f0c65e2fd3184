# Fits a cohort in shards:
# snakemake -s cohort.smk --cores 4 --keep-going --config manifest=subjects.tsv shards=10 out=models
MANIFEST = config["manifest"]
OUT = config.get("out", "models")
SHARDS = int(config.get("shards", 10))
DEGREE = int(config.get("degree", 80))


rule all:
    input: f"{OUT}/status.txt"


# Exit status 1 means that some rows couldn't be fitted. The status files list them, and the workflow continues.
rule shard:
    input: MANIFEST
    output: OUT + "/report/{index}.json"
    threads: 2
    shell:
        "spharm fit --manifest {input} --max-degree {DEGREE} --threads {threads} --output {OUT} "
        "--shard {wildcards.index}/{SHARDS} --keep-going --skip-existing --status {OUT}/status/{wildcards.index}.tsv "
        "--report {output} || test $? = 1 -a -e {output}"


rule status:
    input: expand(OUT + "/report/{index}.json", index=range(SHARDS))
    output: OUT + "/status.txt"
    shell: "spharm status {OUT}/status --manifest {MANIFEST} > {output}"
