//! Arrow files.

use arrow_array::RecordBatch;
use arrow_ipc::writer::FileWriter;
use arrow_schema::{ArrowError, SchemaRef};

/// Writes an Arrow file into memory, from where it is taken piece by piece.
pub struct Writer(FileWriter<Vec<u8>>);

impl Writer {
    pub fn new(schema: &SchemaRef) -> Result<Self, ArrowError> {
        Ok(Self(FileWriter::try_new(vec![], schema)?))
    }

    pub fn append(&mut self, batches: &[RecordBatch]) -> Result<Vec<u8>, ArrowError> {
        batches.iter().try_for_each(|batch| self.0.write(batch))?;
        self.taken()
    }

    pub fn finish(&mut self) -> Result<Vec<u8>, ArrowError> {
        self.0.finish()?;
        self.taken()
    }

    /// What was written since the last call.
    pub fn taken(&mut self) -> Result<Vec<u8>, ArrowError> {
        self.0.flush()?;
        Ok(std::mem::take(self.0.get_mut()))
    }
}
