//! From the card back into memory.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use bytemuck::Pod;
use wgpu::{Buffer, BufferDescriptor, BufferUsages, CommandEncoderDescriptor, MapMode};

use crate::error::LodError;
use crate::gpu::device::Gpu;
use crate::job::Job;

/// Bytes that are copied at once: more memory than this is not asked for.
const CHUNK_BYTES: u64 = 1 << 26;

/// The first `count` values of a buffer.
///
/// # Errors
/// [`LodError::Device`], [`LodError::Cancelled`].
pub(crate) fn read<T: Pod>(
    gpu: &Gpu,
    source: &Buffer,
    count: usize,
    job: &Job,
) -> Result<Vec<T>, LodError> {
    let byte_count = (count * size_of::<T>()) as u64;
    let mut values = Vec::with_capacity(count);
    if count == 0 {
        return Ok(values);
    }
    // whole values in every part
    let part = (CHUNK_BYTES.min(byte_count) / size_of::<T>() as u64) * size_of::<T>() as u64;
    let descriptor = BufferDescriptor {
        label: Some("read back"),
        size: part.next_multiple_of(4),
        usage: BufferUsages::MAP_READ | BufferUsages::COPY_DST,
        mapped_at_creation: false,
    };
    let target = gpu.allocating(|| gpu.device.create_buffer(&descriptor))?;
    let mut offset = 0;
    while offset < byte_count {
        let size = part.min(byte_count - offset);
        let label = Some("read back");
        let mut encoder = gpu.device.create_command_encoder(&CommandEncoderDescriptor { label });
        encoder.copy_buffer_to_buffer(source, offset, &target, 0, size.next_multiple_of(4));
        let submission = gpu.queue.submit([encoder.finish()]);
        let is_mapped = Arc::new(AtomicBool::new(false));
        let told = Arc::clone(&is_mapped);
        target.slice(..size).map_async(MapMode::Read, move |result| {
            told.store(result.is_ok(), Ordering::Release);
        });
        gpu.wait(&submission, job)?;
        if !is_mapped.load(Ordering::Acquire) {
            let why = "did not hand a picture back".to_owned();
            return Err(LodError::Device { why });
        }
        {
            let mapped = target.slice(..size).get_mapped_range();
            let bytes = mapped.map_err(|error| LodError::Device { why: error.to_string() })?;
            values.extend(bytemuck::pod_collect_to_vec::<u8, T>(&bytes));
        }
        target.unmap();
        offset += size;
    }
    Ok(values)
}
