"""Zarr stores of finished cubes: a chunk that is lost is said so, and never read as zeros."""

from __future__ import annotations

from typing import TYPE_CHECKING

from zarr.storage import FsspecStore, LocalStore, WrapperStore

from pipeline.errors import Damaged

if TYPE_CHECKING:
    import xarray as xr
    from zarr.abc.store import ByteRequest
    from zarr.core.buffer import Buffer, BufferPrototype


class WholeChunks(WrapperStore[LocalStore | FsspecStore]):
    """A store of Zarr format 3 whose arrays have all their chunks, as every finished cube has.

    Reading a chunk that is not there raises Damaged with the place of the chunk; Zarr itself takes
    it for one of fill values (Zarr specification 3.0, "Stored values").
    """

    async def get(
        self, key: str, prototype: BufferPrototype, byte_range: ByteRequest | None = None
    ) -> Buffer | None:
        found = await super().get(key, prototype, byte_range)
        if found is None and "c" in key.split("/"):
            store = self._store
            place = store.root if isinstance(store, LocalStore) else store.path
            raise Damaged(f"{place}/{key}", "this chunk is lost")
        return found


def open_whole(store: LocalStore | FsspecStore) -> xr.Dataset:
    """A finished cube as an xarray Dataset that reads its chunks when they are used."""
    import xarray as xr

    return xr.open_zarr(WholeChunks(store), chunks=None)
