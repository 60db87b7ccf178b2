"""The ledger's study: each rule of the plan left out or undone in a small scene, and measured."""
