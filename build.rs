//! Generates the Rust code of the CAN messages from `src/can/gapwatch.dbc`.

use std::path::PathBuf;
use std::{env, error::Error, fs};

use dbc_codegen::{
    AttributeField, AttributeScope, AttributeStruct, Config, FeatureConfig, FieldSource,
};

const DBC: &str = "src/can/gapwatch.dbc";

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed={DBC}");

    let content = fs::read_to_string(DBC).map_err(|e| format!("cannot read {DBC}: {e}"))?;
    let out = PathBuf::from(env::var("OUT_DIR")?).join("gapwatch_dbc.rs");

    // One constant `ATTRIBUTES` a message: what the DBC says beyond its signals.
    let attributes = AttributeStruct {
        type_path: "MessageAttributes",
        const_name: "ATTRIBUTES",
        scope: AttributeScope::Message,
        require: "E2EDataId",
        fields: &[
            AttributeField {
                name: "data_id",
                source: FieldSource::Attr("E2EDataId"),
            },
            AttributeField {
                name: "cycle_ms",
                source: FieldSource::Attr("GenMsgCycleTime"),
            },
            AttributeField {
                name: "minimum_gap_ms",
                source: FieldSource::Attr("GenMsgDelayTime"),
            },
        ],
        for_node: None,
    };
    Config::builder()
        .dbc_name("gapwatch.dbc")
        .dbc_content(&content)
        .impl_debug(FeatureConfig::Always)
        .impl_error(FeatureConfig::Always)
        .impl_embedded_can_frame(FeatureConfig::Never)
        .check_ranges(FeatureConfig::Always)
        .allow_dead_code(true)
        .attribute_structs(&[attributes])
        .build()
        .write_to_file(&out)?;
    Ok(())
}
