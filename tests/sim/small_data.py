"""The configuration of the tests' data set: two shards, the second one shorter."""

SMALL = {"grasps": 6, "cases": 3, "seed": 7, "shard_grasps": 4}
